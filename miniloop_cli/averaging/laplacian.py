"""Weighted least squares over differences on a graph: the linear problem of motion averaging.

Rotations (in the tangent space) and translations both require vectors x with x_i - x_j = d_ij on every edge (i, j).
The normal equations are L x = A' W d with the graph's Laplacian L = A' W A, the same for the three coordinates.
The gauge: x of the first scan is zero.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging.approximate_cholesky import Factor, apply, eliminate
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.view_graph import adjacency
from miniloop_cli.typing import Floats, Ints

DENSE_SCANS = 128
"""Up to this size a dense Cholesky factorisation is as fast, and needs no compilation."""

CG_STEPS = 300

INEXACT = 0.03
"""Tolerance of `solve` for one of several reweighted steps: the next one mends what is left."""

STALE_STEPS = 20
"""Steps with an old factor that cost about as much as a new one."""

WEIGHT_RANGE = 1e10
"""Weights below the largest by more are raised to this, or the equations would lose their digits."""


def spread(x: Floats) -> float:
    """Root mean square of the rows of x (n, 3) about their mean: the size of an increment, independent of the gauge."""
    return float(np.sqrt(((x - x.mean(0)) ** 2).sum(1).mean()))


class Differences:
    """The problem on one connected graph of `count` scans and edges `pairs` (m, 2), for many weights and d."""

    def __init__(self, count: int, pairs: Ints) -> None:
        self.count, self.pairs = count, pairs
        if count > DENSE_SCANS:
            self.start, neighbour, edge = adjacency(count, pairs)
            self.neighbour, self.edge = neighbour.astype(np.int32), edge.astype(np.int32)  # half the memory traffic
            self.factor: Factor | None = None
            self.uniform = np.random.default_rng(0).random(99991)

    def solve(self, weights: Floats, d: Floats, tolerance: float = 1e-10) -> Floats:
        """x (n, 3), x[0] = 0, that minimises sum of w_e |x_i - x_j - d_e|^2.

        `weights` (m,) not negative, `d` (m, 3). Large graphs: conjugate gradients, stopped when the error in the energy
        norm has fallen by about `tolerance`.
        """
        i, j = self.pairs.T
        weights = np.maximum(weights, weights.max(initial=0.0) / WEIGHT_RANGE)
        wd = weights * d.T
        b = np.stack([np.bincount(i, c, self.count) - np.bincount(j, c, self.count) for c in wd], axis=1)
        degree = np.asarray(np.bincount(i, weights, self.count) + np.bincount(j, weights, self.count), float)
        x = self._dense(weights, degree, b) if self.count <= DENSE_SCANS else self._cg(weights, degree, b, tolerance)
        return x - x[0]

    def _dense(self, weights: Floats, degree: Floats, b: Floats) -> Floats:
        from scipy.linalg import cho_factor, cho_solve

        n, x = self.count, np.zeros((self.count, 3))
        if n > 1:
            L = -np.bincount(self.pairs @ [n, 1], weights, n * n).reshape(n, n)
            L += L.T
            L[np.diag_indices(n)] = degree
            x[1:] = cho_solve(cho_factor(L[1:, 1:], check_finite=False), b[1:], check_finite=False)
        return x

    def _cg(self, weights: Floats, degree: Floats, b: Floats, tolerance: float) -> Floats:
        """Preconditioned by the factor of earlier weights while that suffices, else by a new one."""
        if self.factor is not None:
            x, steps = self._iterated(self.factor, weights, degree, b, tolerance, STALE_STEPS)
            if steps < STALE_STEPS:
                return x
        self.factor = eliminate(self.count, self.pairs, weights, self.uniform)
        return self._iterated(self.factor, weights, degree, b, tolerance, CG_STEPS)[0]

    def _iterated(
        self, factor: Factor, weights: Floats, degree: Floats, b: Floats, tolerance: float, most: int
    ) -> tuple[Floats, int]:
        """`conjugate_gradients` on this graph."""
        order, start, row, value, D = factor
        first, neighbour, weight = self.start, self.neighbour, weights[self.edge]
        return conjugate_gradients(first, neighbour, weight, degree, order, start, row, value, D, b, tolerance, most)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def conjugate_gradients(
    first: Ints,
    neighbour: Ints,
    weight: Floats,
    degree: Floats,
    order: Ints,
    start: Ints,
    row: Ints,
    value: Floats,
    D: Floats,
    b: Floats,
    tolerance: float,
    most: int,
) -> tuple[Floats, int]:
    """x (n, 3) with Laplacian x = b, column by column, preconditioned by the factor (order .. D); number of steps."""
    n = len(b)
    x, r, z = np.zeros((n, 3)), b.copy(), np.empty((n, 3))
    p, Lp = np.zeros((n, 3)), np.empty((n, 3))
    alpha, beta, rz, enough = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for step in range(most + 1):
        apply(order, start, row, value, D, r, z)
        done = True
        for c in range(3):
            new = 0.0
            for v in range(n):
                new += r[v, c] * z[v, c]
            if step == 0:
                enough[c] = tolerance * tolerance * new
            beta[c] = new / rz[c] if rz[c] > 0 else 0.0
            rz[c] = new
            done = done and new <= enough[c]
            alpha[c] = 0.0
        if done:
            return x, step
        for v in range(n):
            for c in range(3):
                p[v, c] = z[v, c] + beta[c] * p[v, c]
        for v in range(n):
            s0, s1, s2 = degree[v] * p[v, 0], degree[v] * p[v, 1], degree[v] * p[v, 2]
            for a in range(first[v], first[v + 1]):
                u, w = neighbour[a], weight[a]
                s0 -= w * p[u, 0]
                s1 -= w * p[u, 1]
                s2 -= w * p[u, 2]
            Lp[v, 0], Lp[v, 1], Lp[v, 2] = s0, s1, s2
            alpha[0] += p[v, 0] * s0
            alpha[1] += p[v, 1] * s1
            alpha[2] += p[v, 2] * s2
        for c in range(3):
            alpha[c] = rz[c] / alpha[c] if alpha[c] > 0 and rz[c] > enough[c] else 0.0
        for v in range(n):
            for c in range(3):
                x[v, c] += alpha[c] * p[v, c]
                r[v, c] -= alpha[c] * Lp[v, c]
    return x, most
