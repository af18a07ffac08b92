"""Absolute rotations from relative ones: L1 on the Lie algebra, then iteratively reweighted least squares.

Chatterjee & Govindu, "Efficient and robust large-scale rotation averaging", ICCV 2013. Both stages repeat one step:
residuals of the edges in the tangent space, a sparse weighted least squares for the increments, the increments applied
on the group. L1 uses the weights 1 / |r|, IRLS those of the Geman-McClure function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.averaging.initialization import tree_start, trust, voted_start
from miniloop_cli.averaging.laplacian import INEXACT, Differences, spread, squared
from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry import quaternion_kernels as kernels
from miniloop_cli.geometry.se3 import quaternions, rotations
from miniloop_cli.runtime.blocks import ONE_THREAD, Blocks
from miniloop_cli.scene.view_graph import GraphError, checked_pairs, checked_weights, require_connected
from miniloop_cli.typing import Floats, Ints


@dataclass(frozen=True)
class RotationAverage:
    """Rotations of all scans, the first the identity, and residuals of the edges.

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
    start: Literal["votes", "tree"] = "votes",
    l1_iterations: int = 10,
    irls_iterations: int = 50,
    scale_deg: float = 3.0,
    tolerance_deg: float = 1e-3,
    blocks: Blocks = ONE_THREAD,
) -> RotationAverage:
    """Rotations R_world_cam that agree with the relative rotations R_j_i = R_world_j' R_world_i, robustly.

    `count` scans; `pairs` (m, 2) rows (i, j); `R_j_i` (m, 3, 3); `weights` (m,) inliers or information of the edges, or
    None: all equal. Edges of weight 0 are ignored.
    `start`: "votes" (robust, with checked loops) or "tree" (without weights the plain variant, as in the paper).
    `scale_deg`: Geman-McClure's scale; residuals well above it have nearly no weight. `tolerance_deg`: root mean square
    of the increments at which the iterations end. `blocks`: threads that share the loops over edges and scans; the
    result has the same bytes for any number.

    Raises ConfigError for an unknown start, GraphError for impossible edges, and if those of positive weight do not
    connect all scans.
    """
    pairs = checked_pairs(count, pairs)
    weights = checked_weights(weights, len(pairs))
    q_all = _quaternions(R_j_i, len(pairs), blocks)
    used = np.flatnonzero(weights)
    require_connected(count, pairs[used])
    edges, q_j_i, w = pairs[used], q_all[used], weights[used]
    if start not in ("votes", "tree"):
        raise ConfigError(f"averaging starts from 'votes' or from a 'tree', not from {start!r}")
    if count < 2:
        return _result(np.eye(1, 4), pairs, q_all, True, 0, blocks)

    scale, tolerance = np.radians(scale_deg), np.radians(tolerance_deg)
    if start == "tree":
        q, false_beyond = tree_start(count, edges, q_j_i, w), np.inf
    else:
        T_j_i = np.hstack([q_j_i, np.zeros((len(edges), 3))])
        q = voted_start(count, edges, T_j_i, trust(w), (float(np.cos(scale)), np.inf), blocks)
        q, false_beyond = np.ascontiguousarray(q[:, :4]), 20.0
    system = Differences(count, edges, blocks)
    step, iterations = np.inf, 0

    def advance(loss: Callable[[Floats], Floats]) -> float:
        """One Gauss-Newton step; `loss`: weights of squared residuals in units of the scale. Returns its size, rad."""
        r, weights = np.empty((len(edges), 3)), np.empty(len(edges))

        def reweight(low: int, high: int) -> None:
            r[low:high] = kernels.residuals(q, edges[low:high], q_j_i[low:high])
            weights[low:high] = w[low:high] * loss(squared(r[low:high]) / scale**2)

        def update(low: int, high: int) -> None:
            kernels.update(q[low:high], x[low:high])

        blocks.map(reweight, len(edges))
        x = system.solve(weights, r, tolerance=INEXACT)
        blocks.map(update, count)
        return spread(x)

    for k in range(l1_iterations):
        # 1 / |r|, smoothed at first: the edges of a tree have residual zero and would get infinite weights. After the
        # votes, residuals of 20 scales and more are false edges, not drift that L1 should spread over the loops.
        smooth = max(2 / 2**k, 1 / 8) ** 2
        step = advance(partial(_l1, smooth=smooth, false_beyond=false_beyond))
        iterations += 1
        if step < scale / 30:
            break
    for _ in range(irls_iterations):
        step = advance(_geman_mcclure)
        iterations += 1
        if step < tolerance:
            break
    return _result(q, pairs, q_all, step < tolerance, iterations, blocks)


def _l1(r2: Floats, smooth: float, false_beyond: float) -> Floats:
    return 1 / np.sqrt(r2 + smooth) / (1 + r2 / false_beyond**2)


def _geman_mcclure(r2: Floats) -> Floats:
    return 1 / (1 + r2) ** 2


def _quaternions(R_j_i: ArrayLike, edges: int, blocks: Blocks) -> Floats:
    R_j_i = np.asarray(R_j_i, dtype=np.float64)
    if R_j_i.shape != (edges, 3, 3):
        raise GraphError(f"{edges} edges need rotations of shape ({edges}, 3, 3), got {R_j_i.shape}")
    q_j_i = np.empty((edges, 4))

    def convert(low: int, high: int) -> None:
        R = R_j_i[low:high]
        if not np.isfinite(R).all():
            e = low + int(np.flatnonzero(~np.isfinite(R).all((1, 2)))[0])
            raise GraphError(f"the rotation of edge {e} is not finite")
        if len(reflected := np.flatnonzero(np.linalg.det(R) <= 0)):
            e = low + int(reflected[0])
            raise GraphError(f"the matrix of edge {e} is not a rotation: its determinant is not positive")
        q_j_i[low:high] = quaternions(R, w_first=True)

    blocks.map(convert, edges)
    return q_j_i


def _result(q: Floats, pairs: Ints, q_j_i: Floats, converged: bool, iterations: int, blocks: Blocks) -> RotationAverage:
    def angles_deg(low: int, high: int) -> Floats:
        r = kernels.residuals(q, pairs[low:high], q_j_i[low:high])
        return np.degrees(np.sqrt(squared(r)))

    residual_deg = np.concatenate([np.empty(0), *blocks.map(angles_deg, len(pairs))])
    R = rotations(q, w_first=True)
    R_world_cam = R[0].T @ R
    R_world_cam[0] = np.eye(3)
    return RotationAverage(R_world_cam, residual_deg, bool(converged), iterations)
