"""A result that can be used again: what is kept of each recording, and how the recordings lie to each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.runtime.artifact_store import content_fingerprint
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Floats, Floats32, Ints, Pair


@dataclass(frozen=True)
class MapPart:
    """One recording, registered by itself: its trajectory in a world of its own, and k keyframes to go on with.

    `source`, `layout`: where it lay and how it was read; `total`: its frames, registered or not. Of the n registered
    frames: frame (n,) numbers in the recording, stamps_s (n,), T_world_cam (n, 4, 4), covariance (n, 6, 6) of (w, v)
    in T_world_cam [exp(w) | v], NaN where unknown. Of the keyframes: keyframe (k,) rows of these; images (k,) hashes of
    their colour images; features, with depth, as if each image had been taken at one instant; views. `edges` join
    keyframes; they have inlier matches only. `timing`: what was undone.
    """

    name: str
    source: str
    layout: str
    total: int
    camera: Camera
    feature_type: str
    timing: Timing
    frame: Ints
    stamps_s: Floats
    T_world_cam: Floats
    covariance: Floats
    keyframe: Ints
    images: tuple[str, ...]
    features: tuple[ScanFeatures, ...]
    views: tuple[View | None, ...]
    edges: EdgeTable

    def __len__(self) -> int:
        return len(self.keyframe)

    @property
    def T_world_key(self) -> Floats:
        """(k, 4, 4) poses of the keyframes, in the recording's own world."""
        return self.T_world_cam[self.keyframe]

    @cached_property
    def contents(self) -> tuple[str, ...]:
        """Of each keyframe a hash of its features."""
        return tuple(content_fingerprint([f.px_ideal, f.z_m, f.descriptors]) for f in self.features)


@dataclass(frozen=True)
class MapPoints:
    """Points of the map: points_m (p, 3) in the map's world, covariances_m2 (p, 3, 3).

    of_feature (f,): the point that each feature shows, features counted through all keyframes; -1 for those that only
    their own keyframe saw.
    """

    points_m: Floats
    covariances_m2: Floats
    of_feature: Ints


@dataclass(frozen=True)
class Retrieval:
    """What keyframes are found by: words (w, d) of a vocabulary, vectors (K, w d) of the keyframes, of length 1."""

    words: Floats32
    vectors: Floats32


@dataclass(frozen=True)
class Joined:
    """How the recordings of a map lie to each other; K keyframes, those of all recordings one after the other.

    T_world_cam (K, 4, 4), covariance (K, 6, 6) as in MapPart; piece (r,) of each recording: recordings of one number
    share one world, 0 the piece of most keyframes. `solved`: for each pair of recordings the edges between their
    keyframes as they were solved, numbered within the two, those of the first recording before those of the second.
    `edges`: those between recordings that the poses rest on, numbered through the map. `doubts`: what speaks against
    how recordings lie to each other, in sentences; `notes`: what else is to be known of that. `certified`: whether no
    other arrangement of the edges of recordings that are joined is better, and by what share of the cost at most:
    `relative_gap`, infinite where it is not known.
    """

    T_world_cam: Floats
    covariance: Floats
    piece: Ints
    solved: Mapping[Pair, EdgeTable]
    edges: EdgeTable
    landmarks: MapPoints
    retrieval: Retrieval
    doubts: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    certified: bool = False
    relative_gap: float = float("inf")


def first_keyframes(parts: Sequence[MapPart]) -> Ints:
    """(r + 1,) number of the first keyframe of each recording, counted through all of them; the last is their total."""
    return np.cumsum([0, *(len(part) for part in parts)])


def recording_of_keyframes(parts: Sequence[MapPart]) -> Ints:
    """(K,) the number of the recording of each keyframe."""
    return np.repeat(np.arange(len(parts)), [len(part) for part in parts])


@dataclass(frozen=True)
class SceneMap:
    """Recordings, how they lie to each other, and the settings (as saved) and the seed that made them."""

    parts: tuple[MapPart, ...]
    joined: Joined
    settings: Mapping[str, Any]
    seed: int

    @property
    def feature_type(self) -> str:
        """What the descriptors of all keyframes are."""
        return self.parts[0].feature_type

    @cached_property
    def first(self) -> Ints:
        """(r + 1,) number of the first keyframe of each recording, and how many there are."""
        return first_keyframes(self.parts)

    @cached_property
    def of_part(self) -> Ints:
        """(K,) the number of the recording of each keyframe."""
        return recording_of_keyframes(self.parts)

    @cached_property
    def features(self) -> list[ScanFeatures]:
        """Of all keyframes."""
        return [features for part in self.parts for features in part.features]

    @cached_property
    def first_feature(self) -> Ints:
        """(K + 1,) number of the first feature of each keyframe, counted through the map; the last is their total."""
        return np.cumsum([0, *(len(features) for features in self.features)])

    def keyframes_of(self, part: int) -> slice:
        """Where the keyframes of a recording lie among all."""
        return slice(int(self.first[part]), int(self.first[part + 1]))
