"""Weighted least squares over differences on a graph: the linear problem of motion averaging.

Rotations (in the tangent space) and translations both require vectors x with x_i - x_j = d_ij on every edge (i, j).
The normal equations are L x = A' W d with the graph's Laplacian L = A' W A, the same for the three coordinates.
The gauge: x of the first scan is zero.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging.approximate_cholesky import Factor, Scans32, eliminate, sampling_numbers
from miniloop_cli.averaging.conjugate_gradients import Laplacian, conjugate_gradients
from miniloop_cli.runtime.blocks import ONE_THREAD, Blocks
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


def squared(r: Floats) -> Floats:
    """Squared lengths (m,) of the rows of r (m, 3)."""
    return np.einsum("mc,mc->m", r, r)


class Differences:
    """The problem on one connected graph of `count` scans and edges `pairs` (m, 2), for many weights and d.

    The threads of `blocks` share loops over scans.
    """

    def __init__(self, count: int, pairs: Ints, blocks: Blocks = ONE_THREAD) -> None:
        self.count, self.pairs, self.blocks = count, pairs, blocks
        if count > DENSE_SCANS:
            # In the order of their scans, edges that are read one after the other lie near each other in memory.
            self.by_scan = np.lexsort((pairs[:, 1], pairs[:, 0]))
            self.first, neighbour, edge = adjacency(count, pairs)
            second = pairs[edge, 0] == neighbour
            self.neighbour = neighbour.astype(np.uint32)  # half the memory traffic
            self.ends = (2 * edge + second).astype(np.uint32)
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
            weights = weights / weights.max()  # the factor is in single precision, whose range is small
            L, b = self._equations(weights, d)
            x = self._cg(weights, L, b, tolerance)
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

    def _equations(self, weights: Floats, d: Floats) -> tuple[Laplacian, Floats]:
        weight, degree, b = np.empty(len(self.ends)), np.empty(self.count), np.empty((self.count, 3))
        self.blocks.map(equations, self.count, self.first, self.ends, weights, d, weight, degree, b)
        return (self.first, self.neighbour, weight, degree), b

    def _cg(self, weights: Floats, L: Laplacian, b: Floats, tolerance: float) -> Floats:
        """Preconditioned by the factor of earlier weights until its extra steps cost as much as a new one."""
        digits = -np.log10(tolerance)
        if self.factor is not None:
            usual = self.steps_a_digit * digits
            most = int(usual) + STALE_STEPS
            x, steps = conjugate_gradients(L, self.factor, b, tolerance, most, self.blocks)
            self.late += steps - usual
            if steps < most:
                self.factor = None if self.late > STALE_STEPS else self.factor
                return x
        for light in (LIGHT, 0.0):
            self.factor, self.late = self._factor(weights, light), 0.0
            x, steps = conjugate_gradients(L, self.factor, b, tolerance, CG_STEPS, self.blocks)
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
        rows = self.by_scan[used[self.by_scan]]
        return eliminate(self.count, self.pairs[rows], weights[rows], self.uniform)


@njit(cache=True, nogil=True, error_model="numpy")
def equations(
    low: int,
    high: int,
    first: Ints,
    ends: Scans32,
    weights: Floats,
    d: Floats,
    weight: Floats,
    degree: Floats,
    b: Floats,
) -> None:
    """The Laplacian's `weight` (2m,) and `degree` (n,), and b = A' W d (n, 3), of the scans low..high.

    W: `weights` (m,) of the edges, whose differences are d (m, 3).

    `ends` (2m,): 2 e for the first scan of edge e, 2 e + 1 for the second, scan after scan as in `first` (n+1,).
    """
    for v in range(low, high):
        total = b0 = b1 = b2 = 0.0
        for a in range(first[v], first[v + 1]):
            e, second = ends[a] >> 1, ends[a] & 1
            w = weights[e]
            weight[a] = w
            total += w
            if second:
                w = -w
            b0 += w * d[e, 0]
            b1 += w * d[e, 1]
            b2 += w * d[e, 2]
        degree[v], b[v, 0], b[v, 1], b[v, 2] = total, b0, b1, b2
