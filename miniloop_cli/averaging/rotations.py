"""Absolute rotations from relative ones: L1 on the Lie algebra, then iteratively reweighted least squares.

Chatterjee & Govindu, "Efficient and robust large-scale rotation averaging", ICCV 2013. Both stages repeat one step:
residuals of the edges in the tangent space, a sparse weighted least squares for the increments, the increments applied
on the group. L1 is had by the weights 1 / |r|, IRLS by those of the Geman-McClure function.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.averaging import kernels
from miniloop_cli.averaging.graph import Floats, GraphError, Ints, checked_pairs, checked_weights, require_connected
from miniloop_cli.averaging.linear import Differences
from miniloop_cli.averaging.spanning import loop_errors, tree_start


@dataclass(frozen=True)
class RotationAverage:
    """Rotations of all scans, the first the identity, and what the edges say to them.

    `R_world_cam` (n, 3, 3); `residual_deg` (m,) angle between each edge and the result; `iterations`: linear solves;
    `converged`: the last increment was below the tolerance.
    """

    R_world_cam: Floats
    residual_deg: Floats
    converged: bool
    iterations: int


def average_rotations(
    count: int,
    pairs: ArrayLike,
    R_j_i: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    loops: bool = True,
    l1_iterations: int = 10,
    irls_iterations: int = 40,
    scale_deg: float = 3.0,
    tolerance_deg: float = 1e-3,
) -> RotationAverage:
    """Rotations R_world_cam that agree with the relative rotations R_j_i = R_world_j' R_world_i, robustly.

    `count` scans; `pairs` (m, 2) rows (i, j); `R_j_i` (m, 3, 3); `weights` (m,) inliers or information of the edges, or
    None: all alike (the plain variant of the paper, with `loops=False`). Edges of weight 0 are left out.
    `loops`: edges that contradict their triangles count less in the start. `scale_deg`: where Geman-McClure's
    influence turns (residuals well above count for nothing). `tolerance_deg`: largest increment at the end.

    Raises GraphError where the edges of positive weight do not connect all scans, or an argument is no graph.
    """
    pairs = checked_pairs(count, pairs)
    weights = checked_weights(weights, len(pairs))
    q_all = _quaternions(R_j_i, len(pairs))
    used = np.flatnonzero(weights)
    require_connected(count, pairs[used])
    edges, q_j_i, w = pairs[used], q_all[used], weights[used]

    trust = w
    if loops:
        error = loop_errors(count, edges, q_j_i, w)
        trust = w / (1 + (error / np.radians(scale_deg)) ** 2)
    q = tree_start(count, edges, q_j_i, trust)
    scale = np.radians(scale_deg)
    tolerance = np.radians(tolerance_deg)
    system = Differences(count, edges)
    step, iterations = 0.0 if count < 2 else np.inf, 0
    smoothing = 8 * scale
    for _ in range(l1_iterations):
        r = kernels.residuals(q, edges, q_j_i)
        step = _advance(q, system, trust / np.hypot(np.linalg.norm(r, axis=1), smoothing), r)
        smoothing = max(smoothing / 2, scale / 8)
        iterations += 1
    for _ in range(irls_iterations):
        r = kernels.residuals(q, edges, q_j_i)
        step = _advance(q, system, w / (1 + (r * r).sum(1) / scale**2) ** 2, r)
        iterations += 1
        if step < tolerance:
            break
    return _result(q, pairs, q_all, step < tolerance, iterations)


def _advance(q: Floats, system: Differences, weights: Floats, r: Floats) -> float:
    """One Gauss-Newton step in place; returns the largest increment, rad."""
    x = system.solve(weights, r)
    kernels.update(q, x)
    return float(np.sqrt((x * x).sum(1).max(initial=0.0)))


def _quaternions(R_j_i: ArrayLike, edges: int) -> Floats:
    from scipy.spatial.transform import Rotation

    R_j_i = np.asarray(R_j_i, dtype=np.float64)
    if R_j_i.shape != (edges, 3, 3):
        raise GraphError(f"{edges} edges need rotations of shape ({edges}, 3, 3), got {R_j_i.shape}")
    if not np.isfinite(R_j_i).all():
        e = int(np.flatnonzero(~np.isfinite(R_j_i).all((1, 2)))[0])
        raise GraphError(f"the rotation of edge {e} is not finite")
    return np.ascontiguousarray(Rotation.from_matrix(R_j_i).as_quat(scalar_first=True))


def _result(q: Floats, pairs: Ints, q_j_i: Floats, converged: bool, iterations: int) -> RotationAverage:
    from scipy.spatial.transform import Rotation

    R = Rotation.from_quat(q, scalar_first=True).as_matrix()
    residual_deg = np.degrees(np.linalg.norm(kernels.residuals(q, pairs, q_j_i), axis=1))
    R_world_cam = R[0].T @ R
    R_world_cam[0] = np.eye(3)
    return RotationAverage(R_world_cam, residual_deg, bool(converged), iterations)
