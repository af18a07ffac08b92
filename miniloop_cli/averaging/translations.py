"""Absolute translations from relative ones, rotations known: sparse linear least squares, robustly reweighted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.averaging.initialization import trust, voted_start
from miniloop_cli.averaging.laplacian import Differences, spread, squared
from miniloop_cli.runtime.blocks import ONE_THREAD, Blocks
from miniloop_cli.scene.view_graph import GraphError, checked_pairs, checked_weights, require_connected
from miniloop_cli.typing import Floats, Ints


@dataclass(frozen=True)
class TranslationAverage:
    """Translations of all scans, the first zero, and residuals of the edges.

    `t_world_cam` (n, 3) m; `residual_m` (m,) distance between each edge and the result; `iterations`: linear solves;
    `converged`: the last increments were small against the scale.
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
    reweights: int = 8,
    scale_m: float = 0.03,
    blocks: Blocks = ONE_THREAD,
) -> TranslationAverage:
    """Translations t_world_cam that agree with t_j_i = R_j' (t_i - t_j), R_i = R_world_cam[i].

    `R_world_cam` (n, 3, 3); `pairs` (m, 2) rows (i, j); `t_j_i` (m, 3) m; `weights` (m,) 1 / sigma^2 or inliers, or
    None: all equal. Edges of weight 0 are ignored.
    `robust=False`: one least squares (the paper: with R_j' times the mean of R_j q - R_i p over an edge's matches p, q
    as t_j_i and their number as weight, it satisfies the 3D correspondences best). Otherwise a start by votes, then up
    to `reweights` least squares with Cauchy's weights 1 / (1 + (residual / scale_m)^2).
    `blocks`: threads that share the loops over edges and scans; the result has the same bytes for any number.

    Raises GraphError for impossible edges, and if those of positive weight do not connect all scans.
    """
    R_world_cam = np.asarray(R_world_cam, dtype=np.float64).reshape(-1, 3, 3)
    count = len(R_world_cam)
    pairs = checked_pairs(count, pairs)
    weights = checked_weights(weights, len(pairs))
    t_j_i = np.asarray(t_j_i, dtype=np.float64)
    if t_j_i.shape != (len(pairs), 3):
        raise GraphError(f"{len(pairs)} edges need translations of shape ({len(pairs)}, 3), got {t_j_i.shape}")
    strange = np.flatnonzero(~np.isfinite(t_j_i).all(axis=1))
    if len(strange):
        raise GraphError(f"the translation of edge {strange[0]} is not finite")
    used = np.flatnonzero(weights)
    require_connected(count, pairs[used])
    edges, w = pairs[used], weights[used]
    d_all = np.einsum("eab,eb->ea", R_world_cam[pairs[:, 1]], t_j_i)
    d = d_all[used]

    system = Differences(count, edges, blocks)
    step, iterations = 0.0, 1
    if robust and count > 1:
        T_j_i = np.hstack([np.eye(1, 4).repeat(len(edges), axis=0), d])
        t = voted_start(count, edges, T_j_i, trust(w), (0.0, (2 * scale_m) ** 2), blocks)[:, 4:]
        r, reweighted = np.empty((len(edges), 3)), np.empty(len(edges))

        def reweight(low: int, high: int) -> None:
            r[low:high] = _residuals(t, edges[low:high], d[low:high])
            reweighted[low:high] = w[low:high] / (1 + squared(r[low:high]) / scale_m**2)

        step, iterations = np.inf, 0
        while iterations < reweights and step >= 1e-3 * scale_m:
            blocks.map(reweight, len(edges))
            x = system.solve(reweighted, r, tolerance=1e-3)
            t, step, iterations = t + x, spread(x), iterations + 1
        t = t - t[:1]
    else:
        t = system.solve(w, d)

    def distances_m(low: int, high: int) -> Floats:
        return np.sqrt(squared(_residuals(t, pairs[low:high], d_all[low:high])))

    residual_m = np.concatenate([np.empty(0), *blocks.map(distances_m, len(pairs))])
    return TranslationAverage(t, residual_m, step < 0.03 * scale_m, iterations)


def _residuals(t: Floats, pairs: Ints, d: Floats) -> Floats:
    return d - (t[pairs[:, 0]] - t[pairs[:, 1]])
