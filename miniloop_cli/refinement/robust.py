"""Robust kernels on squared, whitened residuals s: cost rho(s)/2, weight rho'(s); rho(s) -> s for small s."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit

Kernel = Literal["none", "cauchy", "geman-mcclure"]
KERNELS: dict[str, int] = {"none": 0, "cauchy": 1, "geman-mcclure": 2}


@njit(cache=True, nogil=True)
def robust(kind: int, s: float, c2: float) -> tuple[float, float]:
    """(rho(s), rho'(s)) of the kernel number `kind` with squared scale c2: Cauchy c2 log(1 + s/c2), Geman-McClure
    s c2/(c2 + s), none s."""
    if kind == 0:
        return s, 1.0
    w = c2 / (c2 + s)
    if kind == 1:
        return c2 * np.log1p(s / c2), w
    return s * w, w * w
