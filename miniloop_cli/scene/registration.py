"""The result of a run, and the error for a run without poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from miniloop_cli.config import Settings
from miniloop_cli.errors import MiniloopError
from miniloop_cli.scene.calibration import Calibration
from miniloop_cli.scene.certificate import Certificate
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.extracted_scan import ExtractedScan
from miniloop_cli.scene.landmarks import NO_LANDMARKS, Landmarks
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.sequence import Note, Sequence
from miniloop_cli.scene.timing import Timing
from miniloop_cli.scene.tracked import TrackStatus
from miniloop_cli.typing import Bytes, Floats, Ints


class RegistrationError(MiniloopError):
    """The scans could be read, but give no trajectory; the message names the reason.

    `run`: the results up to then, for the report.
    """

    def __init__(self, message: str, run: Registration | None = None) -> None:
        super().__init__(message)
        self.run = run


@dataclass(frozen=True)
class Registration:
    """The result of a run: scans with their features, judged edges, poses with covariances, seconds a stage.

    `timings_s` is elapsed time, `cpu_timings_s` that of the processor, all threads of the process together.
    `notes`: those of the recording, of gravity and of a pose prior. `tracking` (n,): numbers of TrackStatus, None
    without tracking. `certificate`: of the averaged poses. `leveled`: the world was rotated by gravity so that z is up.
    `landmarks`: points of the bundle adjustment; none without one.
    `velocity` (n, 6): (w, v) rad/s and m/s of each camera in its own frame, with which the timing was corrected; None
    without timing.
    `thumbnails`: small JPEG files by frame, of those that tracking read; none without it.
    `calibration`: the estimated camera, if it was requested; it is then the camera of the sequence.
    """

    sequence: Sequence
    settings: Settings
    seed: int
    scans: list[ExtractedScan]
    edges: EdgeTable
    poses: Poses
    covariance: Floats
    timing: Timing
    timings_s: dict[str, float] = field(default_factory=dict)
    cpu_timings_s: dict[str, float] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()
    tracking: Ints | None = None
    certificate: Certificate | None = None
    leveled: bool = False
    landmarks: Landmarks = NO_LANDMARKS
    velocity: Floats | None = None
    calibration: Calibration | None = None
    thumbnails: Mapping[int, Bytes] = field(default_factory=dict)

    @property
    def scan_frames(self) -> Ints:
        """Frames that were matched as scans, ascending: the keyframes of a whole recording, else all."""
        if self.tracking is None:
            return np.arange(len(self.scans))
        return np.flatnonzero(self.tracking == TrackStatus.KEYFRAME)
