"""The result of tracking through a recording: keyframes, motions between frames, observations of points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.geometry import se3
from miniloop_cli.scene.partial_motion import PartialMotion, closed
from miniloop_cli.scene.poses import Poses
from miniloop_cli.typing import Bools, Bytes, Floats, Ints

ENOUGH_POINTS = 12  # that agree on a motion determine it


class TrackStatus(IntEnum):
    """The status of a frame in the front end."""

    FOLLOWED = 0  # points link it to a keyframe
    KEYFRAME = 1
    UNREADABLE = 2
    BLANK = 3  # black, or of one colour
    NO_DEPTH = 4  # and no points that link it to a keyframe


class Repeat(IntEnum):
    """Which images of a frame equal those of the frame before exactly, which no sensor produces."""

    NONE = 0
    COLOR = 1
    DEPTH = 2  # under a new colour image


@dataclass(frozen=True)
class Observations:
    """Points tracked by optical flow, k of them: frame, track (k,); px, px_ideal (k, 2); z_m (k,) or NaN;
    slope (k, 2) m/px, of depth along the image."""

    frame: Ints
    track: Ints
    px: Floats
    px_ideal: Floats
    z_m: Floats
    slope: Floats

    @staticmethod
    def joined(parts: Sequence[Observations]) -> Observations:
        """All parts one after the other."""
        none = Observations(*(np.zeros(0, np.int64),) * 2, *(np.zeros((0, 2)),) * 2, np.zeros(0), np.zeros((0, 2)))
        return Observations(
            *(np.concatenate([getattr(p, c.name) for p in (none, *parts)]) for c in fields(Observations))
        )

    def subset(self, rows: NDArray[Any]) -> Observations:
        """These rows (indices or a mask)."""
        return Observations(*(getattr(self, c.name)[rows] for c in fields(Observations)))


@dataclass(frozen=True)
class Link:
    """The motion between a keyframe and a frame, as in FrameMotions; `surface` is what depth and brightness tell."""

    T_cam_key: Floats
    information: Floats
    support: int
    surface: PartialMotion | None = None
    by_surface: bool = False

    @property
    def determined(self) -> bool:
        """Whether it is known in all directions."""
        return bool(determined(self.information, np.array(self.support), np.array(self.by_surface)))


def determined(information: Floats, support: Ints, by_surface: Bools) -> Bools:
    """Whether motions are known in all directions: information (..., 6, 6), support and by_surface (...).

    Enough points determine them in any case.
    """
    return ((support >= ENOUGH_POINTS) & ~by_surface) | closed(information)


@dataclass(frozen=True)
class FrameMotions:
    """The result of tracking for n frames, a row each.

    status (n,) numbers of TrackStatus; problem (n,) words; key (n,) the keyframe of each, -1 none;
    T_cam_key (n, 4, 4) from the key's camera to the frame's, information (n, 6, 6) of (w, v) in [exp(w) | v] T_cam_key;
    support (n,) points that agree on it; by_surface (n,) bool: it comes from depth and brightness, without points;
    T_by_surface and surface_information the same motion by depth and brightness alone, as far as they tell it;
    repeat (n,) numbers of Repeat.
    """

    status: Ints
    problem: NDArray[np.str_]
    key: Ints
    T_cam_key: Floats
    information: Floats
    support: Ints
    by_surface: Bools
    T_by_surface: Floats
    surface_information: Floats
    repeat: Ints

    def __len__(self) -> int:
        return len(self.status)

    @property
    def determined(self) -> Bools:
        """(n,) whether the motion since the keyframe is known in all directions."""
        return (self.key >= 0) & determined(self.information, self.support, self.by_surface)


COLUMNS = tuple(column.name for column in fields(FrameMotions))
PICTURE = "thumbnail_"  # prefix of the number of its frame in the name of an array


@dataclass(frozen=True)
class TrackedPart(FrameMotions):
    """The frames first..first + n - 1 of a recording; its arrays are filled frame by frame.

    `thumbnails`: JPEG files by frame, of those that could be read.
    """

    first: int = 0
    seen: list[Observations] = field(default_factory=list)
    thumbnails: dict[int, Bytes] = field(default_factory=dict)

    @staticmethod
    def of(first: int, last: int) -> TrackedPart:
        """An empty part."""
        n = last - first + 1
        return TrackedPart(
            status=np.zeros(n, np.int64),
            problem=np.full(n, "", "<U400"),
            key=np.full(n, -1),
            T_cam_key=np.tile(np.eye(4), (n, 1, 1)),
            information=np.zeros((n, 6, 6)),
            support=np.zeros(n, np.int64),
            by_surface=np.zeros(n, bool),
            T_by_surface=np.tile(np.eye(4), (n, 1, 1)),
            surface_information=np.zeros((n, 6, 6)),
            repeat=np.full(n, int(Repeat.NONE)),
            first=first,
        )

    def set(self, frame: int, status: TrackStatus, problem: str = "") -> None:
        """Set the status of a frame, and its reason."""
        self.status[frame - self.first] = status
        self.problem[frame - self.first] = problem[:400]

    def link(self, frame: int, key: int, motion: Link) -> None:
        """Set the motion of a frame since its keyframe."""
        row = frame - self.first
        self.key[row], self.T_cam_key[row], self.information[row] = key, motion.T_cam_key, motion.information
        self.support[row], self.by_surface[row] = motion.support, motion.by_surface
        if motion.surface:
            self.T_by_surface[row], self.surface_information[row] = motion.surface

    def observe(self, seen: Observations) -> None:
        """Add observations of tracked points."""
        self.seen.append(seen)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All arrays (n, ...) by name."""
        seen = Observations.joined(self.seen)
        own = {name: getattr(self, name) for name in COLUMNS}
        pictures = {f"{PICTURE}{k}": file for k, file in self.thumbnails.items()}
        followed = {f"seen_{c.name}": getattr(seen, c.name) for c in fields(seen)}
        return own | {"first": np.array([self.first])} | followed | pictures

    @staticmethod
    def from_arrays(arrays: Mapping[str, NDArray[Any]]) -> TrackedPart:
        """The part that `arrays` (n, ...) gave."""
        own = {name: arrays[name] for name in COLUMNS}
        seen = Observations(*(arrays[f"seen_{c.name}"] for c in fields(Observations)))
        pictures = {int(name.removeprefix(PICTURE)): a for name, a in arrays.items() if name.startswith(PICTURE)}
        return TrackedPart(first=int(arrays["first"][0]), seen=[seen], thumbnails=pictures, **own)


@dataclass(frozen=True)
class Tracked(FrameMotions):
    """All frames of a recording; tracks are numbered through. `thumbnails` as in TrackedPart."""

    seen: Observations
    thumbnails: Mapping[int, Bytes] = field(default_factory=dict)

    @staticmethod
    def of(parts: Sequence[TrackedPart]) -> Tracked:
        """The parts joined; each begins with the frame that the one before ends with."""
        n = parts[-1].first + len(parts[-1])
        whole, seen, tracks = TrackedPart.of(0, n - 1), [], 0
        for part in parts:
            # A frame that two parts share gets its motion from the earlier part, as the later one starts there.
            skip = int(part.first > 0)
            rows = slice(part.first + skip, part.first + len(part))
            for name in COLUMNS:
                getattr(whole, name)[rows] = getattr(part, name)[skip:]
            own = Observations.joined(part.seen)
            seen.append(replace(own, track=own.track + tracks))
            tracks += int(own.track.max(initial=-1)) + 1
        pictures = {k: file for part in parts for k, file in part.thumbnails.items()}
        columns = {name: getattr(whole, name) for name in COLUMNS}
        return Tracked(seen=Observations.joined(seen), thumbnails=pictures, **columns)

    @property
    def keyframes(self) -> Ints:
        """Frame numbers (k,) of the keyframes, ascending."""
        return np.flatnonzero(self.status == TrackStatus.KEYFRAME)

    def all_poses(self, keyframe_poses: Poses) -> Poses:
        """Poses of all frames: those between keyframes by the motion since their keyframe."""
        n, keyframes = len(self), self.keyframes
        T, component = np.tile(np.eye(4), (n, 1, 1)), np.full(n, -1)
        T[keyframes], component[keyframes] = keyframe_poses.T_world_cam, keyframe_poses.component
        between = np.flatnonzero((self.key >= 0) & (self.status == TrackStatus.FOLLOWED))
        key = self.key[between]
        T[between] = T[key] @ se3.inverse(self.T_cam_key[between])
        component[between] = component[key]
        return Poses(T, component)
