"""The pixel of a point in an image whose camera is not known exactly: residual in units of `sigma_px`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from miniloop_cli.geometry.camera_parameters import NAMES, OF_PIXELS, CameraParameters, Projection
from miniloop_cli.refinement.robust import Robust
from miniloop_cli.refinement.terms import BEHIND, NEAR_M
from miniloop_cli.typing import Bools, Floats, Ints


@dataclass(frozen=True)
class FreePixelTerm:
    """Measured, distorted pixels (2, k), and the camera's parameters."""

    px: Floats
    parameters: CameraParameters
    sigma_px: float
    robust: Robust

    def of(self, rows: Ints | slice) -> Self:
        return replace(self, px=np.ascontiguousarray(self.px[:, rows]))

    def at(self, parameters: CameraParameters) -> Self:
        return replace(self, parameters=parameters)

    def linearise(self, p_cam: Floats) -> tuple[Floats, Floats]:
        """The predicted pixel of p_cam (3, k) minus the measured one."""
        seen, lost = self._projected(p_cam)
        residual = (seen.px - self.px) / self.sigma_px
        residual[0, lost], residual[1, lost] = BEHIND, 0.0
        return residual, np.where(lost, 0.0, seen.by_point / self.sigma_px)

    def by_parameters(self, p_cam: Floats) -> Floats:
        seen, lost = self._projected(p_cam)
        found = np.zeros((2, len(NAMES), p_cam.shape[1]))
        found[:, :OF_PIXELS] = np.where(lost, 0.0, seen.by_parameters / self.sigma_px)
        return found

    def _projected(self, p_cam: Floats) -> tuple[Projection, Bools]:
        """Projection of the points, and which (k,) are behind the camera or out of reach of the lens."""
        behind = p_cam[2] < NEAR_M
        seen = self.parameters.project(np.where(behind, np.array([[0.0], [0.0], [1.0]]), p_cam))
        return seen, behind | ~np.isfinite(seen.px).all(axis=0)
