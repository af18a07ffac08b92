"""What every dataset reader returns: an ordered list of colour + depth frames, one camera, perhaps a ground truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.typing import Bools, Bytes, Floats, Floats32


@dataclass(frozen=True)
class Frame:
    """One RGB-D frame as it is stored: the colour stamp names it (s)."""

    timestamp_s: float
    color: ImageSource
    depth: ImageSource
    mask: ImageSource | None = None  # pixels to ignore, where the recording comes with masks
    depth_timestamp_s: float | None = None  # where depth has stamps of its own


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


@dataclass(frozen=True)
class DepthFormat:
    """How a layout stores depth beyond the camera's scale."""

    no_reading: int | None = None  # a stored value that means "no reading", besides 0
    resample: bool = False  # depth may be a registered image of lower resolution (phones): nearest neighbour


@dataclass(frozen=True)
class Sequence:
    """An RGB-D recording. Frames are sorted by time; decoding happens in `read_scan`, one frame at a time."""

    name: str
    root: Path  # its folder, or the one file that holds all of it
    camera: Camera
    frames: tuple[Frame, ...]
    ground_truth_path: Path | None = None  # a file, or the folder of one pose file a frame; see read_ground_truth
    notes: tuple[str, ...] = field(default=())  # what the reader dropped or assumed, for the log and the report
    available: tuple[int, int] = (0, 0)  # colour and depth images before they were paired; 0: not counted
    depth_format: DepthFormat = DepthFormat()
    layout: str = ""  # the name of the layout that read it; `open_sequence` fills it in
