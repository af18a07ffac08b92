"""A map: the stored data of each recording, and the relative poses of the recordings."""

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
    """One recording, registered by itself: its trajectory in its own world, and k keyframes to match others with.

    `source`, `layout`: its path and its layout; `total`: its frames, registered or not. For the n registered frames:
    frame (n,) numbers in the recording, stamps_s (n,), T_world_cam (n, 4, 4), covariance (n, 6, 6) of (w, v) in
    T_world_cam [exp(w) | v], NaN where unknown. For the keyframes: keyframe (k,) rows of these; images (k,) hashes of
    their colour images; features with depth, corrected to one instant for each image; views. `edges` join keyframes;
    they have inlier matches only. `timing`: the corrected timing.
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

    of_feature (f,): the point of each feature, with features counted through all keyframes; -1 for features seen in one
    keyframe only.
    """

    points_m: Floats
    covariances_m2: Floats
    of_feature: Ints


@dataclass(frozen=True)
class Retrieval:
    """The retrieval index: words (w, d) of a vocabulary, unit vectors (K, w d) of the keyframes."""

    words: Floats32
    vectors: Floats32


@dataclass(frozen=True)
class Joined:
    """The relative poses of the recordings of a map; K keyframes, those of all recordings one after the other.

    T_world_cam (K, 4, 4), covariance (K, 6, 6) as in MapPart; piece (r,) of each recording: recordings with one number
    share one world, 0 is the piece of most keyframes. `solved`: for each pair of recordings the solved edges between
    their keyframes, numbered within the two, those of the first recording before those of the second. `edges`: those
    between recordings that the poses depend on, numbered through the map. `doubts`: sentences on what contradicts the
    relative poses of recordings; `notes`: other sentences on them. `certified`: whether no other poses fit the edges of
    joined recordings better by more than the share `relative_gap` of the cost, infinite if unknown.
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
    """Recordings, their relative poses, and the settings (as saved) and the seed of their registration."""

    parts: tuple[MapPart, ...]
    joined: Joined
    settings: Mapping[str, Any]
    seed: int

    @property
    def feature_type(self) -> str:
        """The type of all descriptors."""
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
        """Features of all keyframes."""
        return [features for part in self.parts for features in part.features]

    @cached_property
    def first_feature(self) -> Ints:
        """(K + 1,) number of the first feature of each keyframe, counted through the map; the last is their total."""
        return np.cumsum([0, *(len(features) for features in self.features)])

    def keyframes_of(self, part: int) -> slice:
        """The range of a recording's keyframes among all."""
        return slice(int(self.first[part]), int(self.first[part + 1]))
