"""Inputs and results of the refinement."""

from __future__ import annotations

from collections.abc import Sequence as Many
from dataclasses import dataclass, field

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.two_cameras import TwoCameras
from miniloop_cli.scene.calibration import Calibration
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.landmarks import NO_LANDMARKS, Landmarks
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.priors import Accelerometer, Vertical
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.scene.timing import Timing
from miniloop_cli.scene.tracked import Tracked
from miniloop_cli.typing import Floats


@dataclass(frozen=True)
class Scans:
    """The scans for the refinement: features, points, stamps of colour and of depth (n,) seconds, the camera.

    `vertical`: from an accelerometer, if there is one. `two`: a separate depth camera that is to be calibrated.
    """

    features: Many[ScanFeatures]
    points: Many[ScanPoints]
    stamps_s: Floats
    depth_stamps_s: Floats
    camera: Camera
    feature_type: str
    vertical: Vertical | None = None
    two: TwoCameras | None = None

    @property
    def accelerometer(self) -> Accelerometer | None:
        """Readings in the camera's axes, where there are any."""
        return self.vertical.accelerometer if self.vertical else None


@dataclass(frozen=True)
class Between:
    """A whole recording of n frames, whose keyframes are the scans: the points tracked through all of them.

    T_cam_key (n, 4, 4), `key` (n,) and `seen` as in Tracked; stamps of all frames (n,) seconds.
    """

    tracked: Tracked
    stamps_s: Floats
    depth_stamps_s: Floats
    accelerometer: Accelerometer | None = None  # in the camera's axes

    @staticmethod
    def of(
        tracked: Tracked, whole: Sequence, vertical: Vertical | None, accelerometer: Accelerometer | None
    ) -> Between:
        """`whole`: the recording; `vertical`: the axes of its `accelerometer`, as found from the keyframes."""
        turned = accelerometer.turned(vertical.R_cam_sensor) if vertical and accelerometer else None
        return Between(tracked, whole.stamps_s, whole.depth_stamps_s, turned)


@dataclass(frozen=True)
class Refined:
    """Poses, their covariances (n, 6, 6; NaN where there are none), the estimated timing and the landmarks.

    velocity (n, 6): (w, v) rad/s and m/s of each camera in its own frame, with which the timing was corrected; None
    without a timing. `calibration`: the estimated camera, if calibration was requested.
    """

    poses: Poses
    covariance: Floats
    timing: Timing = field(default_factory=Timing)
    landmarks: Landmarks = NO_LANDMARKS
    velocity: Floats | None = None
    calibration: Calibration | None = None
