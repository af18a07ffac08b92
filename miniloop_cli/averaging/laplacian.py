"""Weighted least squares over differences on a graph: the linear problem of motion averaging.

Rotations (in the tangent space) and translations both require vectors x with x_i - x_j = d_ij on every edge (i, j).
The normal equations are L x = A' W d with the graph's Laplacian L = A' W A, the same for the three coordinates.
The gauge: x of the first scan is zero.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging.approximate_cholesky import (
    Factor,
    Scans32,
    Singles,
    apply,
    eliminate,
    sampling_numbers,
)
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.view_graph import adjacency, components
from miniloop_cli.typing import Floats, Ints

DENSE_SCANS = 128
"""Up to this size a dense Cholesky factorisation is as fast, and needs no compilation."""

CG_STEPS = 300

INEXACT = 0.03
"""Tolerance of `solve` for one of several reweighted steps: the next one mends what is left."""

STALE_STEPS = 20
"""Steps, beyond those with a new factor, that cost about as much as a new one."""

LIGHT = 1e-3
"""Of the median weight: lighter edges, such as false ones, take no part in the factor, which they would fill."""

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
            # In the order of their scans, edges that are read one after the other lie near each other in memory.
            self.by_scan = np.lexsort((pairs[:, 1], pairs[:, 0]))
            self.pairs = pairs[self.by_scan]
            self.start, neighbour, edge = adjacency(count, self.pairs)
            self.neighbour, self.edge = neighbour.astype(np.uint32), edge.astype(np.uint32)  # half the memory traffic
            self.factor: Factor | None = None
            self.late = self.steps_a_digit = 0.0  # steps beyond the usual since the factor was made; the usual ones
            self.uniform = sampling_numbers()

    def solve(self, weights: Floats, d: Floats, tolerance: float = 1e-10) -> Floats:
        """x (n, 3), x[0] = 0, that minimises sum of w_e |x_i - x_j - d_e|^2.

        `weights` (m,) not negative, `d` (m, 3). Large graphs: conjugate gradients, stopped when the error in the energy
        norm has fallen by about `tolerance`.
        """
        weights = np.maximum(weights, weights.max(initial=0.0) / WEIGHT_RANGE)
        if self.count <= DENSE_SCANS:
            i, j = self.pairs.T
            wd = weights * d.T
            b = np.stack([np.bincount(i, c, self.count) - np.bincount(j, c, self.count) for c in wd], axis=1)
            degree = np.asarray(np.bincount(i, weights, self.count) + np.bincount(j, weights, self.count), float)
            x = self._dense(weights, degree, b)
        else:
            weights = weights[self.by_scan] / weights.max()  # the factor is in single precision, whose range is small
            b, degree = right_side(self.count, self.pairs, self.by_scan, weights, d)
            x = self._cg(weights, degree, b, tolerance)
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
        """Preconditioned by the factor of earlier weights until its extra steps cost as much as a new one."""
        digits = -np.log10(tolerance)
        if self.factor is not None:
            usual = self.steps_a_digit * digits
            most = int(usual) + STALE_STEPS
            x, steps = self._iterated(self.factor, weights, degree, b, tolerance, most)
            self.late += steps - usual
            if steps < most:
                self.factor = None if self.late > STALE_STEPS else self.factor
                return x
        for light in (LIGHT, 0.0):
            self.factor, self.late = self._factor(weights, light), 0.0
            x, steps = self._iterated(self.factor, weights, degree, b, tolerance, CG_STEPS)
            if steps < CG_STEPS:
                break
        self.steps_a_digit = steps / digits
        return x

    def _factor(self, weights: Floats, light: float) -> Factor:
        """Of the edges that are not light, and of those that join parts that nothing else joins."""
        used = weights > light * np.median(weights)
        if not used.all():
            part = components(self.count, self.pairs[used])
            used |= part[self.pairs[:, 0]] != part[self.pairs[:, 1]]
        return eliminate(self.count, self.pairs[used], weights[used], self.uniform)

    def _iterated(
        self, factor: Factor, weights: Floats, degree: Floats, b: Floats, tolerance: float, most: int
    ) -> tuple[Floats, int]:
        """`conjugate_gradients` on this graph."""
        order, start, row, value, D = factor
        first, neighbour, weight = self.start, self.neighbour, weights[self.edge]
        return conjugate_gradients(first, neighbour, weight, degree, order, start, row, value, D, b, tolerance, most)


@njit(cache=True, nogil=True, error_model="numpy")
def right_side(count: int, pairs: Ints, rows: Ints, weights: Floats, d: Floats) -> tuple[Floats, Floats]:
    """b = A' W d (n, 3), and the sums of the weights at each scan (n,); d of edge e is row rows[e].

    pairs (m, 2), rows (m,), weights (m,).
    """
    b, degree = np.zeros((count, 3)), np.zeros(count)
    for e in range(len(pairs)):
        i, j, row, w = pairs[e, 0], pairs[e, 1], rows[e], weights[e]
        degree[i] += w
        degree[j] += w
        for c in range(3):
            b[i, c] += w * d[row, c]
            b[j, c] -= w * d[row, c]
    return b, degree


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def conjugate_gradients(
    first: Ints,
    neighbour: Scans32,
    weight: Floats,
    degree: Floats,
    order: Scans32,
    start: Ints,
    row: Scans32,
    value: Singles,
    D: Singles,
    b: Floats,
    tolerance: float,
    most: int,
) -> tuple[Floats, int]:
    """x (n, 3) with Laplacian x = b, column by column, preconditioned by the factor (order .. D); number of steps.

    The graph by scans: `first` (n + 1,), and `neighbour` and `weight` (2 m,) from there on; `degree` (n,): the sums of
    the weights. The factor (`order`, `start`, `row`, `value`, `D`) is that of `eliminate`. It stops when the residual
    is `tolerance` times b, or after `most` steps.
    """
    n = len(b)
    x, r, z = np.zeros((n, 3)), b.copy(), np.empty((n, 3), dtype=np.float32)
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
