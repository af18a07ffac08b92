"""What one observation of a track contributes: residuals, robust cost, gradient and Hessian in the camera frame."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.refinement.robust import robust
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Bools, Floats, Ints

_NEAR_M = 0.02  # a point nearer than this (or behind) has no useful projection
_BEHIND = 1e4  # its squared residual: constant, so it neither pulls nor pays


class Model(NamedTuple):
    """Pinhole intrinsics (px), 1/px, squared kernel scales, kernel number.

    Curvatures multiply the Hessian's share of pixels and depths: 1 for Gauss-Newton.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    inverse_sigma_px: float
    c2_px: float
    c2_depth: float
    kind: int
    curvature_px: float = 1.0
    curvature_depth: float = 1.0


class Observations(NamedTuple):
    """Track p owns rows start[p]..start[p + 1] - 1, by frame. Depth and its 1/sigma are 0 where there is none."""

    start: Ints
    frame: NDArray[np.uint32]
    px: Floats
    z: Floats
    inverse_sigma_z: Floats


@njit(cache=True, nogil=True, error_model="numpy")
def camera_point(R: Floats, t: Floats, f: int, X: Floats, p: int) -> tuple[float, float, float]:
    a, b, c = X[p, 0] - t[f, 0], X[p, 1] - t[f, 1], X[p, 2] - t[f, 2]
    return (
        R[f, 0, 0] * a + R[f, 1, 0] * b + R[f, 2, 0] * c,
        R[f, 0, 1] * a + R[f, 1, 1] * b + R[f, 2, 1] * c,
        R[f, 0, 2] * a + R[f, 1, 2] * b + R[f, 2, 2] * c,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def whitened(obs: Observations, k: int, model: Model, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Whitened residuals (predicted minus measured) u, v, depth."""
    near = 1 / z
    return (
        (model.fx * x * near + model.cx - obs.px[k, 0]) * model.inverse_sigma_px,
        (model.fy * y * near + model.cy - obs.px[k, 1]) * model.inverse_sigma_px,
        (z - obs.z[k]) * obs.inverse_sigma_z[k],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def observation_cost(obs: Observations, k: int, model: Model, x: float, y: float, z: float) -> float:
    if z < _NEAR_M:
        return robust(model.kind, _BEHIND, model.c2_px)[0]
    ru, rv, rz = whitened(obs, k, model, x, y, z)
    return robust(model.kind, ru * ru + rv * rv, model.c2_px)[0] + robust(model.kind, rz * rz, model.c2_depth)[0]


@njit(cache=True, nogil=True, error_model="numpy")
def observation_terms(
    obs: Observations, k: int, model: Model, x: float, y: float, z: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Gradient a (3) and the entries 00 11 02 12 22 of A (01 is zero) with respect to the camera point."""
    if z < _NEAR_M:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ru, rv, rz = whitened(obs, k, model, x, y, z)
    w = robust(model.kind, ru * ru + rv * rv, model.c2_px)[1]
    wz = robust(model.kind, rz * rz, model.c2_depth)[1]
    near = 1 / z
    gu, gv = model.fx * near * model.inverse_sigma_px, model.fy * near * model.inverse_sigma_px
    gz = obs.inverse_sigma_z[k]
    xz, yz = x * near, y * near
    a0, a1 = w * gu * ru, w * gv * rv
    a2 = wz * gz * rz - a0 * xz - a1 * yz
    A00, A11 = w * model.curvature_px * gu * gu, w * model.curvature_px * gv * gv
    A22 = A00 * xz * xz + A11 * yz * yz + wz * model.curvature_depth * gz * gz
    return a0, a1, a2, A00, A11, -A00 * xz, -A11 * yz, A22


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate_tracks(
    obs: Observations, model: Model, R: Floats, t: Floats, X: Floats, residual: Floats, weight: Floats
) -> None:
    """Whitened residuals (k, 3) [u, v, depth] and robust weights (k, 2) [pixel, depth]; NaN and 0 behind the camera."""
    for p in range(len(obs.start) - 1):
        for k in range(obs.start[p], obs.start[p + 1]):
            x, y, z = camera_point(R, t, obs.frame[k], X, p)
            if z < _NEAR_M:
                residual[k], weight[k] = np.nan, 0.0
                continue
            ru, rv, rz = whitened(obs, k, model, x, y, z)
            residual[k, 0], residual[k, 1], residual[k, 2] = ru, rv, rz
            weight[k, 0] = robust(model.kind, ru * ru + rv * rv, model.c2_px)[1]
            weight[k, 1] = robust(model.kind, rz * rz, model.c2_depth)[1]


@njit(cache=True, nogil=True, error_model="numpy")
def mark_seen_together(obs: Observations, together: Bools) -> None:
    """Set together[i, j], i < j, of (n, n) for frames that share a track."""
    for p in range(len(obs.start) - 1):
        for k in range(obs.start[p], obs.start[p + 1]):
            for m in range(k + 1, obs.start[p + 1]):
                together[obs.frame[k], obs.frame[m]] = True
