"""What every dataset reader returns: an ordered list of colour + depth frames, one camera, perhaps a ground truth."""

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
    """One RGB-D frame as it is stored: the colour stamp names it (s)."""

    timestamp_s: float
    color: ImageSource
    depth: ImageSource
    mask: ImageSource | None = None  # pixels to ignore, where the recording comes with masks
    depth_timestamp_s: float | None = None  # where depth has stamps of its own
    camera: Camera | None = None  # its own intrinsics where they differ: it is read as the recording's camera sees it


@dataclass(frozen=True)
class Trajectory:
    """Poses over time: (n,) seconds, strictly increasing, and (n, 4, 4) camera to world."""

    timestamps_s: Floats
    T_world_cam: Floats
    source: str = ""  # for people: the format of the file, and what was converted


@dataclass(frozen=True)
class Scan:
    """One decoded frame: (h, w, 3) uint8 RGB and (h, w) float32 depth in metres, 0 = no reading.

    `mask`, where there is one, is (h, w) bool, True = ignore this pixel; the depth is already 0 there.
    """

    color: Bytes
    depth_m: Floats32
    mask: Bools | None = None


class NoteKind(StrEnum):
    """What was done with a recording, or with what is known beside its images, that its user did not ask for."""

    DROPPED = "dropped"  # files or rows that are not used
    MOST_DROPPED = "most dropped"  # most images are not used: the result is doubtful
    ASSUMED = "assumed"  # what nothing states
    CONTRADICTED = "contradicted"  # assumed, and the recording speaks against it: the result is doubtful
    PAIRED = "paired"  # how images found their partners
    CONVERTED = "converted"  # from other units or formats
    UNUSED = "unused"  # what lies beside the images and is not read
    PRIOR = "prior"  # what became of gravity and of a pose prior
    PROVEN = "proven"  # what is proven of the arrangement of the edges
    IMPOSSIBLE_MOTION = "impossible motion"  # a step of the path that nothing confirms: the result is doubtful
    AMBIGUOUS = "ambiguous"  # a part of the path fits elsewhere nearly as well: the result is doubtful
    UNPROVEN = "unproven"  # another arrangement of the edges may be better: the result is doubtful


@dataclass(frozen=True)
class Note:
    """One sentence on what happened between folder and frames, with number and reason."""

    kind: NoteKind
    text: str

    @property
    def doubtful(self) -> bool:
        """Whether the user should see it unasked: something is missing from the result, or may be wrong."""
        return self.kind in (NoteKind.DROPPED, NoteKind.MOST_DROPPED, NoteKind.ASSUMED, NoteKind.CONTRADICTED)

    def __str__(self) -> str:
        return self.text


def dropped_images(text: str, left: int, total: int) -> Note:
    """The note that `left` of `total` images are not used; `text` says why."""
    return Note(NoteKind.MOST_DROPPED if 2 * left > total else NoteKind.DROPPED, text)


@dataclass(frozen=True)
class ColorOnly:
    """Colour images that no depth image belongs to.

    left_out: the note that they are not used; taken_in: the notes in its place where points are followed through them.
    """

    frames: tuple[Frame, ...]
    left_out: Note
    taken_in: tuple[Note, ...]


@dataclass(frozen=True)
class DepthFormat:
    """How a layout stores depth beyond the camera's scale."""

    no_reading: tuple[float, ...] = ()  # stored values that mean "no reading", besides 0
    no_reading_found: bool = False  # some of these were told from the images; no one states them
    floating: bool = False  # stored as floating-point numbers, not as 16-bit integers
    resample: bool = False  # depth may be a registered image of lower resolution (phones): nearest neighbour


@dataclass(frozen=True)
class DepthCamera:
    """The camera that depth was measured by, where depth is not registered to colour; it is registered as it is read.

    `pose_rows` are the 16 numbers of T_color_depth (points of the depth camera to those of the colour camera, m), row
    by row.
    """

    camera: Camera
    pose_rows: tuple[float, ...]

    @property
    def T_color_depth(self) -> Floats:
        """(4, 4)."""
        return np.array(self.pose_rows).reshape(4, 4)

    def moved(self, step: Floats) -> DepthCamera:
        """The depth camera with the steps (8,) of geometry.depth_camera_parameters taken."""
        camera, T = moved(self.camera, self.T_color_depth, step)
        return DepthCamera(camera, tuple(T.ravel().tolist()))

    def sees_as(self, color: Camera) -> bool:
        """Whether a pixel of depth is taken to be that of colour: the same camera at the same place."""
        own = self.camera
        same = (own.fx, own.fy, own.cx, own.cy, own.lens) == (color.fx, color.fy, color.cx, color.cy, color.lens)
        return same and bool(np.array_equal(self.T_color_depth, np.eye(4)))


@dataclass(frozen=True)
class Sequence:
    """An RGB-D recording. Frames are sorted by time; decoding happens in `read_scan`, one frame at a time."""

    name: str
    root: Path  # its folder, or the one file that holds all of it
    camera: Camera
    frames: tuple[Frame, ...]
    ground_truth_path: Path | None = None  # a file, or the folder of one pose file a frame; see read_ground_truth
    notes: tuple[Note, ...] = field(default=())  # what the reader dropped, assumed ..., for terminal, log and report
    available: tuple[int, int] = (0, 0)  # colour and depth images before they were paired; 0: not counted
    depth_format: DepthFormat = DepthFormat()
    layout: str = ""  # the name of the layout that read it; `open_sequence` fills it in
    depth_camera: DepthCamera | None = None  # where depth is not registered to colour
    topics: str = ""  # of a bag, as the user named them
    color_only: ColorOnly | None = None  # left out, unless points are followed from frame to frame

    def with_frames(self, change: Callable[[Frame], Frame]) -> Sequence:
        """The recording with every frame changed, those without depth, too."""
        alone = self.color_only
        changed = replace(alone, frames=tuple(map(change, alone.frames))) if alone else None
        return replace(self, frames=tuple(map(change, self.frames)), color_only=changed)

    def thinned(self, count: int) -> Sequence:
        """Evenly spaced frames, at most so many.

        Images that are left out on purpose are not images without partner.
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
