"""Lenses of single points, for compiled kernels; the lenses themselves do not need the compiler."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from miniloop_cli.geometry.lens import Lens
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats

MODELS = ("pinhole", "radial-tangential", "fisheye")


class LensNumbers(NamedTuple):
    """A lens as kernels take it: index into MODELS, coefficients (8,), and the first number of its `limit`."""

    model: int
    coefficients: Floats
    limit: float


def lens_numbers(lens: Lens) -> LensNumbers:
    """The numbers of a lens; coefficients that it does not have are 0."""
    return LensNumbers(MODELS.index(lens.model), np.array((*lens.coefficients, *(0.0,) * 8)[:8]), lens.limit[0])


@njit(cache=True, nogil=True, error_model="numpy")
def distort(x: float, y: float, model: int, c: Floats, limit: float) -> tuple[float, float]:
    """Where a lens of any model, with coefficients c (8,), images x, y of the plane z = 1; NaN beyond its limit."""
    if model == 1:
        return distort_radial_tangential(x, y, c, limit)
    if model == 2:
        return distort_fisheye(x, y, c, limit)
    return x, y


@njit(cache=True, nogil=True, error_model="numpy")
def distort_radial_tangential(x: float, y: float, c: Floats, limit: float) -> tuple[float, float]:
    """`radial_tangential.distort` of one point, with coefficients c (8,) and the first number of its `limit`."""
    s = x * x + y * y
    if not s <= limit * limit:
        return np.nan, np.nan
    g = (1.0 + s * (c[0] + s * (c[1] + s * c[4]))) / (1.0 + s * (c[5] + s * (c[6] + s * c[7])))
    bent_x = x * g + 2 * c[2] * x * y + c[3] * (s + 2 * x * x)
    return bent_x, y * g + c[2] * (s + 2 * y * y) + 2 * c[3] * x * y


@njit(cache=True, nogil=True, error_model="numpy")
def distort_fisheye(x: float, y: float, c: Floats, limit: float) -> tuple[float, float]:
    """`fisheye.distort` of one point, with coefficients c (4,) and the first number of its `limit`."""
    radius = np.sqrt(x * x + y * y)
    theta = np.arctan(radius)
    if not theta <= limit:
        return np.nan, np.nan
    s = theta * theta
    measured = theta * (1.0 + s * (c[0] + s * (c[1] + s * (c[2] + s * c[3]))))
    scale = measured / radius if radius > 0 else 1.0
    return x * scale, y * scale
