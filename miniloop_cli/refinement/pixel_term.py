"""The pixel of a point in an image: predicted minus measured, in units of `sigma_px`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.robust import Robust
from miniloop_cli.refinement.terms import BEHIND, NEAR_M
from miniloop_cli.typing import Floats, Ints


@dataclass(frozen=True)
class PixelTerm:
    """Undistorted pixels (2, k), the camera's intrinsics, the noise of a pixel in both directions."""

    px_ideal: Floats
    camera: Camera
    sigma_px: float
    robust: Robust

    def of(self, rows: Ints | slice) -> Self:
        return replace(self, px_ideal=np.ascontiguousarray(self.px_ideal[:, rows]))

    def linearise(self, p_cam: Floats) -> tuple[Floats, Floats]:
        """(u, v) = (fx x/z + cx, fy y/z + cy) minus the pixel."""
        behind = p_cam[2] < NEAR_M
        near = 1 / np.where(behind, 1.0, p_cam[2])
        residual, jacobian = np.empty((2, p_cam.shape[1])), np.zeros((2, 3, p_cam.shape[1]))
        for axis, (f, c) in enumerate(((self.camera.fx, self.camera.cx), (self.camera.fy, self.camera.cy))):
            by_point, ratio = f / self.sigma_px * near, p_cam[axis] * near
            residual[axis] = (f * ratio + c - self.px_ideal[axis]) / self.sigma_px
            jacobian[axis, axis], jacobian[axis, 2] = by_point, -by_point * ratio
        residual[0, behind], residual[1, behind] = BEHIND, 0.0
        return residual, jacobian
