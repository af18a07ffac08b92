"""Absolute translations from relative ones, rotations known: sparse linear least squares, robustly reweighted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.averaging.graph import Floats, GraphError, checked_pairs, checked_weights, require_connected
from miniloop_cli.averaging.linear import Differences


@dataclass(frozen=True)
class TranslationAverage:
    """Translations of all scans, the first zero, and what the edges say to them.

    `t_world_cam` (n, 3) m; `residual_m` (m,) distance between each edge and the result; `iterations`: linear solves;
    `converged`: the last increment was below the tolerance.
    """

    t_world_cam: Floats
    residual_m: Floats
    converged: bool
    iterations: int


def average_translations(
    R_world_cam: ArrayLike,
    pairs: ArrayLike,
    t_j_i: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    robust: bool = True,
    l1_iterations: int = 8,
    reweights: int = 8,
    scale_m: float = 0.03,
    tolerance_m: float = 1e-4,
) -> TranslationAverage:
    """Translations t_world_cam that agree with t_j_i = R_j' (t_i - t_j), R_i = R_world_cam[i].

    `R_world_cam` (n, 3, 3); `pairs` (m, 2) rows (i, j); `t_j_i` (m, 3) m; `weights` (m,) 1 / sigma^2 or inliers, or
    None: all alike. Edges of weight 0 are left out.
    `robust=False`: one least squares (the paper: with the mean of R_j q - R_i p over an edge's matches as R_j t_j_i and
    their number as weight this satisfies the 3D correspondences best). Otherwise L1 first, then `reweights` rounds of
    Cauchy's weights at `scale_m`.

    Raises GraphError where the edges of positive weight do not connect all scans, or an argument is no graph.
    """
    R_world_cam = np.asarray(R_world_cam, dtype=np.float64)
    count = len(R_world_cam)
    pairs = checked_pairs(count, pairs)
    weights = checked_weights(weights, len(pairs))
    t_j_i = np.asarray(t_j_i, dtype=np.float64)
    if t_j_i.shape != (len(pairs), 3) or not np.isfinite(t_j_i).all():
        raise GraphError(f"{len(pairs)} edges need finite translations of shape ({len(pairs)}, 3), got {t_j_i.shape}")
    used = np.flatnonzero(weights)
    require_connected(count, pairs[used])
    edges, w = pairs[used], weights[used]
    d_all = np.einsum("eab,eb->ea", R_world_cam[pairs[:, 1]], t_j_i)
    d = d_all[used]

    t = np.zeros((count, 3))
    system, iterations, step = Differences(count, edges), 0, np.inf
    if not robust:
        t, iterations, step = system.solve(w, d), 1, 0.0
    else:
        smoothing = np.inf
        for k in range(l1_iterations + reweights):
            distance = np.linalg.norm(_residuals(t, edges, d), axis=1)
            if k == 0:
                factor = np.ones(len(edges))
            elif k <= l1_iterations:
                smoothing = max(scale_m / 4, min(smoothing, float(np.median(distance)) * 4) / 2)
                factor = smoothing / np.hypot(distance, smoothing)
            else:
                factor = 1 / (1 + (distance / scale_m) ** 2)
            before, t = t, system.solve(w * factor, d)
            step = np.linalg.norm(t - before, axis=1).max(initial=0.0)
            iterations += 1
            if k > l1_iterations and step < tolerance_m:
                break
    return TranslationAverage(
        t, np.linalg.norm(_residuals(t, pairs, d_all), axis=1), bool(step < 10 * tolerance_m), iterations
    )


def _residuals(t: Floats, pairs: np.ndarray, d: Floats) -> Floats:
    return d - (t[pairs[:, 0]] - t[pairs[:, 1]])
