"""A recording: an ordered list of colour and depth frames, one camera, perhaps a ground truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.depth_camera_parameters import moved
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.typing import Bools, Bytes, Floats, Floats32, Ints


@dataclass(frozen=True)
class Frame:
    """One stored RGB-D frame; its time is the colour stamp (s)."""

    timestamp_s: float
    color: ImageSource
    depth: ImageSource
    mask: ImageSource | None = None  # pixels to ignore, if the recording has masks
    depth_timestamp_s: float | None = None  # if depth has its own stamps
    camera: Camera | None = None  # its own intrinsics, if they differ: it is resampled to the recording's camera


@dataclass(frozen=True)
class Trajectory:
    """Poses over time: (n,) seconds, strictly increasing, and (n, 4, 4) camera to world."""

    timestamps_s: Floats
    T_world_cam: Floats
    source: str = ""  # for messages: the format of the file, and conversions


@dataclass(frozen=True)
class Scan:
    """One decoded frame: (h, w, 3) uint8 RGB and (h, w) float32 depth in metres, 0 = no reading.

    `mask`, if there is one, is (h, w) bool, True = ignore this pixel; the depth is already 0 there.
    """

    color: Bytes
    depth_m: Floats32
    mask: Bools | None = None


class NoteKind(StrEnum):
    """The kinds of notes on a recording and its priors: what was done without the user's request."""

    DROPPED = "dropped"  # files or rows that are not used
    MOST_DROPPED = "most dropped"  # most images are not used: the result is doubtful
    ASSUMED = "assumed"  # not stated by any file
    CONTRADICTED = "contradicted"  # assumed, and the recording contradicts it: the result is doubtful
    PAIRED = "paired"  # how colour and depth images were paired
    CONVERTED = "converted"  # from other units or formats
    UNUSED = "unused"  # files beside the images that are not read
    PRIOR = "prior"  # the use of gravity and of a pose prior
    PROVEN = "proven"  # the certificate of the averaged poses
    IMPOSSIBLE_MOTION = "impossible motion"  # an unconfirmed large step of the path: the result is doubtful
    AMBIGUOUS = "ambiguous"  # a part of the path fits at another place nearly as well: the result is doubtful
    UNPROVEN = "unproven"  # other poses may fit the edges better: the result is doubtful


@dataclass(frozen=True)
class Note:
    """One sentence on how a recording was read, with number and reason."""

    kind: NoteKind
    text: str

    @property
    def doubtful(self) -> bool:
        """Whether it is shown even without --verbose: something is missing from the result, or may be wrong."""
        return self.kind in (NoteKind.DROPPED, NoteKind.MOST_DROPPED, NoteKind.ASSUMED, NoteKind.CONTRADICTED)

    def __str__(self) -> str:
        return self.text


def dropped_images(text: str, left: int, total: int) -> Note:
    """The note that `left` of `total` images are not used; `text` says why."""
    return Note(NoteKind.MOST_DROPPED if 2 * left > total else NoteKind.DROPPED, text)


@dataclass(frozen=True)
class ColorOnly:
    """Colour images without a depth image.

    left_out: the note that they are not used; taken_in: the notes that replace it if points are tracked through them.
    """

    frames: tuple[Frame, ...]
    left_out: Note
    taken_in: tuple[Note, ...]


@dataclass(frozen=True)
class DepthFormat:
    """How a layout stores depth beyond the camera's scale."""

    no_reading: tuple[float, ...] = ()  # stored values that mean "no reading", besides 0
    no_reading_found: bool = False  # some of these were found from the images, not stated
    floating: bool = False  # stored as floating-point numbers, not as 16-bit integers
    resample: bool = False  # depth may be a registered image of lower resolution (phones): nearest neighbour


@dataclass(frozen=True)
class DepthCamera:
    """The depth camera of depth that is not registered to colour; depth is registered while it is read.

    `pose_rows` are the 16 numbers of T_color_depth (points of the depth camera to those of the colour camera, m), row
    by row.
    """

    camera: Camera
    pose_rows: tuple[float, ...]

    @property
    def T_color_depth(self) -> Floats:
        """(4, 4) pose of the depth camera in the frame of the colour camera, m."""
        return np.array(self.pose_rows).reshape(4, 4)

    def moved(self, step: Floats) -> DepthCamera:
        """The depth camera with the steps (8,) of geometry.depth_camera_parameters taken."""
        camera, T = moved(self.camera, self.T_color_depth, step)
        return DepthCamera(camera, tuple(T.ravel().tolist()))

    def sees_as(self, color: Camera) -> bool:
        """Whether depth and colour have the same pixels: the same camera at the same pose."""
        own = self.camera
        same = (own.fx, own.fy, own.cx, own.cy, own.lens) == (color.fx, color.fy, color.cx, color.cy, color.lens)
        return same and bool(np.array_equal(self.T_color_depth, np.eye(4)))


@dataclass(frozen=True)
class Sequence:
    """An RGB-D recording. Frames are sorted by time; decoding happens in `read_scan`, one frame at a time."""

    name: str
    root: Path  # its folder, or its one file
    camera: Camera
    frames: tuple[Frame, ...]
    ground_truth_path: Path | None = None  # a file, or the folder of one pose file a frame; see read_ground_truth
    notes: tuple[Note, ...] = field(default=())  # for terminal, log and report
    available: tuple[int, int] = (0, 0)  # colour and depth images before they were paired; 0: not counted
    depth_format: DepthFormat = DepthFormat()
    layout: str = ""  # the name of its layout, set by `open_sequence`
    depth_camera: DepthCamera | None = None  # if depth is not registered to colour
    topics: str = ""  # of a bag, as given by the user
    color_only: ColorOnly | None = None  # left out, unless points are tracked from frame to frame

    def with_frames(self, change: Callable[[Frame], Frame]) -> Sequence:
        """The recording with every frame changed, also those without depth."""
        alone = self.color_only
        changed = replace(alone, frames=tuple(map(change, alone.frames))) if alone else None
        return replace(self, frames=tuple(map(change, self.frames)), color_only=changed)

    def thinned(self, count: int) -> Sequence:
        """Evenly spaced frames, at most so many.

        Notes on images without partner do not include the frames that are left out here.
        """
        if count >= len(self.frames):
            return self
        keep = np.round(np.linspace(0, len(self.frames) - 1, max(count, 1))).astype(int)
        return replace(self, frames=tuple(self.frames[i] for i in keep), available=(0, 0), color_only=None)

    def with_color_only(self) -> tuple[Sequence, Ints]:
        """The recording with colour images without depth among its frames; the rows (n,) of these frames there."""
        if self.color_only is None:
            return self, np.arange(len(self.frames))
        all_frames = (*self.frames, *self.color_only.frames)
        order = np.argsort([frame.timestamp_s for frame in all_frames], kind="stable")
        notes = (*(note for note in self.notes if note != self.color_only.left_out), *self.color_only.taken_in)
        whole = replace(self, frames=tuple(all_frames[k] for k in order), notes=notes, color_only=None)
        return whole, np.flatnonzero(order < len(self.frames))

    @property
    def stamps_s(self) -> Floats:
        """(n,) colour stamps."""
        return np.array([frame.timestamp_s for frame in self.frames])

    @property
    def depth_stamps_s(self) -> Floats:
        """(n,) depth stamps; those of colour where depth has none of its own."""
        return np.array([frame.depth_timestamp_s or frame.timestamp_s for frame in self.frames])
