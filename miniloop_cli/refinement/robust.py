"""Robust kernels on squared, whitened residuals s: cost rho(s)/2, weight rho'(s); rho(s) -> s for small s."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats

Kernel = Literal["none", "cauchy", "geman-mcclure"]
KERNELS: dict[Kernel, int] = {"none": 0, "cauchy": 1, "geman-mcclure": 2}


@dataclass(frozen=True)
class Robust:
    """A kernel and its scale in sigmas."""

    kernel: Kernel = "none"
    scale: float = 1.0

    def cost(self, s: Floats) -> Floats:
        """rho(s) of squared residuals of any shape."""
        c2 = self.scale**2
        if self.kernel == "cauchy":
            return c2 * np.log1p(s / c2)
        return s if self.kernel == "none" else s * c2 / (c2 + s)

    def weight(self, s: Floats) -> Floats:
        """rho'(s) of squared residuals of any shape."""
        return weight_and_curvature(self.kernel, s, self.scale, 1)[0]


@njit(cache=True, nogil=True, error_model="numpy")
def robust(kind: int, s: float, c2: float) -> tuple[float, float]:
    """(rho(s), rho'(s)) of the kernel number `kind` with squared scale c2: Cauchy c2 log(1 + s/c2), Geman-McClure
    s c2/(c2 + s), none s."""
    if kind == 0:
        return s, 1.0
    w = c2 / (c2 + s)
    if kind == 1:
        return c2 * np.log1p(s / c2), w
    return s * w, w * w


def weight_and_curvature(kernel: Kernel, s: Floats, scale: float, dimension: int) -> tuple[Floats, Floats]:
    """rho'(s), and the mean over directions of the second derivative of rho(|r|^2)/2 by a residual r of `dimension`.

    The curvature, rho' + 2 s rho''/dimension, determines how the minimum moves under noise.
    """
    s = np.asarray(s, float)
    if kernel == "none":
        return np.ones_like(s), np.ones_like(s)
    q = 1 / (1 + s / scale**2)
    power = 1 if kernel == "cauchy" else 2
    return q**power, q**power * (1 - 2 * power * (1 - q) / dimension)


def noise_gain(kernel: Kernel, scale: float, dimension: int) -> float:
    """The factor that turns the inverse of the weighted Hessian into the covariance of the minimum.

    E[w] E[w^2 s] / (d E[curvature]^2), for Gaussian residuals of `dimension` d and unit variance.
    """
    s = np.linspace(0, 60 + 10 * dimension, 200_001)[1:]
    density = s ** (dimension / 2 - 1) * np.exp(-s / 2)
    density /= density.sum()
    w, h = weight_and_curvature(kernel, s, scale, dimension)
    return float((density @ w) * (density @ (w * w * s)) / (dimension * (density @ h) ** 2))
