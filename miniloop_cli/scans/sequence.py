"""What every dataset reader returns: an ordered list of colour + depth frames, one camera, perhaps a ground truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.scans.camera import Camera


@dataclass(frozen=True)
class Frame:
    """One RGB-D frame on disk: the colour stamp names it (s)."""

    timestamp_s: float
    color_path: Path
    depth_path: Path


@dataclass(frozen=True)
class Trajectory:
    """Poses over time: (n,) seconds, strictly increasing, and (n, 4, 4) camera to world."""

    timestamps_s: NDArray[np.float64]
    T_world_cam: NDArray[np.float64]


@dataclass(frozen=True)
class Scan:
    """One decoded frame: (h, w, 3) uint8 RGB and (h, w) float32 depth in metres, 0 = no reading."""

    color: NDArray[np.uint8]
    depth_m: NDArray[np.float32]


@dataclass(frozen=True)
class Sequence:
    """An RGB-D recording. Frames are sorted by time; decoding happens in `read_scan`, one frame at a time."""

    name: str
    root: Path
    camera: Camera
    frames: tuple[Frame, ...]
    ground_truth_path: Path | None = None
    notes: tuple[str, ...] = field(default=())  # what the reader dropped or assumed, for the log and the report
