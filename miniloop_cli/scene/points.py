"""The features of a scan as points in space, and the matches between scans."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.typing import Floats, Ints, Pair

if TYPE_CHECKING:
    pass


Matches = dict[Pair, Ints]


@dataclass(frozen=True)
class ScanPoints:
    """The features with depth of one scan in space: points (n, 3) m, covariances (n, 3, 3) m^2, camera frame."""

    points_m: Floats
    covariances_m2: Floats

    @cached_property
    def sigmas_m(self) -> Floats:
        """Root mean square standard deviation (n,) over the three axes."""
        return np.sqrt(np.trace(self.covariances_m2, axis1=1, axis2=2) / 3)


def scan_points(features: ScanFeatures, camera: Camera) -> ScanPoints:
    """Back-project the features that have a depth (the first rows)."""
    count = features.with_depth
    points = camera.backproject(features.px_ideal[:count], features.z_m[:count])
    return ScanPoints(points, camera.point_covariance(points))
