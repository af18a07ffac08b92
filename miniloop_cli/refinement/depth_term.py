"""The depth of a point: predicted minus measured, in units of its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from miniloop_cli.refinement.robust import Robust
from miniloop_cli.refinement.terms import NEAR_M
from miniloop_cli.typing import Floats, Ints


@dataclass(frozen=True)
class DepthTerm:
    """Depths (k,) along the optical axis, NaN where none was measured, and their standard deviations (k,), m."""

    z_m: Floats
    sigma_m: Floats
    robust: Robust

    def of(self, rows: Ints | slice) -> Self:
        return replace(self, z_m=self.z_m[rows], sigma_m=self.sigma_m[rows])

    def linearise(self, p_cam: Floats) -> tuple[Floats, Floats]:
        """z of p_cam (3, k) minus the measured depth; NaN for a point behind the camera."""
        residual = np.where(p_cam[2] < NEAR_M, np.nan, (p_cam[2] - self.z_m) / self.sigma_m)
        jacobian = np.zeros((1, 3, len(residual)))
        jacobian[0, 2] = 1 / self.sigma_m
        return residual[None], jacobian
