"""What refinement takes and gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.priors import Accelerometer, Vertical
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Floats


@dataclass(frozen=True)
class Scans:
    """What refinement needs of the scans: features, points, stamps of colour and of depth (n,) seconds, the camera.

    `vertical`: what an accelerometer says, where there was one.
    """

    features: Sequence[ScanFeatures]
    points: Sequence[ScanPoints]
    stamps_s: Floats
    depth_stamps_s: Floats
    camera: Camera
    feature_type: str
    vertical: Vertical | None = None

    @property
    def accelerometer(self) -> Accelerometer | None:
        """Readings in the camera's axes, where there are any."""
        return self.vertical.accelerometer if self.vertical else None


@dataclass(frozen=True)
class Refined:
    """Poses, their covariances (n, 6, 6; NaN where there are none) and the timing that was found."""

    poses: Poses
    covariance: Floats
    timing: Timing = field(default_factory=Timing)
