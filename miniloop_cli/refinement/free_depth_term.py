"""The depth of a point, for a depth camera with smooth errors: see geometry/depth_model.py.

The residual is the predicted minus the corrected depth, in standard deviations of the corrected depth. These are the
standard deviations of the reading times the slope of the correction. Without that factor, a correction that shrinks all
depths would shrink all residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from miniloop_cli.geometry.camera_parameters import NAMES, OF_DEPTH, CameraParameters
from miniloop_cli.geometry.depth_model import basis
from miniloop_cli.refinement.robust import Robust
from miniloop_cli.refinement.terms import NEAR_M
from miniloop_cli.refinement.two_cameras import ReadingChange
from miniloop_cli.typing import Floats, Ints


@dataclass(frozen=True)
class FreeDepthTerm:
    """Readings (k,) m, NaN where there is none, their standard deviations (k,) m, and their position in the image.

    `rho` (k,): squared share of the half diagonal. `change`: how the readings themselves depend on the parameters, if
    they do.
    """

    z_m: Floats
    sigma_m: Floats
    rho: Floats
    parameters: CameraParameters
    robust: Robust
    change: ReadingChange | None = None

    def of(self, rows: Ints | slice) -> Self:
        change = self.change and self.change.subset(rows)
        return replace(self, z_m=self.z_m[rows], sigma_m=self.sigma_m[rows], rho=self.rho[rows], change=change)

    def at(self, parameters: CameraParameters) -> Self:
        return replace(self, parameters=parameters)

    def linearise(self, p_cam: Floats) -> tuple[Floats, Floats]:
        corrected, sigma_m, _, _ = self._corrected()
        residual = np.where(p_cam[2] < NEAR_M, np.nan, (p_cam[2] - corrected) / sigma_m)
        jacobian = np.zeros((1, 3, len(residual)))
        jacobian[0, 2] = 1 / sigma_m
        return residual[None], jacobian

    def by_parameters(self, p_cam: Floats) -> Floats:
        corrected, sigma_m, value, growth = self._corrected()
        residual = (p_cam[2] - corrected) / sigma_m
        found = np.zeros((1, len(NAMES), len(residual)))
        found[0, OF_DEPTH] = -value / sigma_m - residual * growth
        if self.change:
            found[0] -= self.change.by_theta * (1 / self.sigma_m)  # the correction grows with the reading as sigma does
        return found

    def _corrected(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Corrected depths (k,) or NaN, their sigmas (k,); derivatives (4, k) of the depth and of the log of sigma."""
        z_m = self.z_m if self.change is None else self.z_m + self.change.step(self.parameters.theta)
        reading = np.isfinite(z_m)
        z_m = np.where(reading, z_m, 1.0)
        value, slope = basis(z_m, self.rho, self.parameters.middle_m)
        step = self.parameters.theta[OF_DEPTH]
        grows = np.maximum(1 + np.tensordot(step, slope, 1), 0.1)  # a correction keeps the order of near and far
        corrected = np.where(reading, z_m + np.tensordot(step, value, 1), np.nan)
        return corrected, self.sigma_m * grows, value, slope / grows
