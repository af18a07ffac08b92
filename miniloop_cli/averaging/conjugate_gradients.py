"""Conjugate gradients on a graph's Laplacian, preconditioned by a sampled factor, in blocks of scans.

Three columns are solved side by side, each with its own step lengths. The preconditioned residual and the direction
are in single precision, as reading memory is what a step costs. The residual follows from the rounded direction, so
that rounding slows the convergence down a little, but does not limit the accuracy.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging.approximate_cholesky import Factor, Scans32, Singles, apply
from miniloop_cli.runtime.blocks import Blocks
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats, Ints

Laplacian = tuple[Ints, Scans32, Floats, Floats]
"""`first` (n+1,), `neighbour` (2m,), `weight` (2m,): the edges of each scan; `degree` (n,): the sums of weights."""


def conjugate_gradients(
    L: Laplacian, factor: Factor, b: Floats, tolerance: float, most: int, blocks: Blocks
) -> tuple[Floats, int]:
    """x (n, 3) with L x = b, column by column, and the number of steps, at most `most`.

    A column is done when the error in the energy norm has fallen by about `tolerance`.
    """
    n = len(b)
    x, r, z = np.zeros((n, 3)), b.copy(), b.astype(np.float32)
    p, Lp = np.zeros((n, 3), dtype=np.float32), np.empty((n, 3))
    rz = enough = np.zeros(3)
    for step in range(most + 1):
        apply(*factor, z)
        before, rz = rz, _total(blocks.map(products, n, r, z))
        if step == 0:
            enough = tolerance * tolerance * rz
        if (rz <= enough).all():
            return x, step
        beta = np.divide(rz, before, out=np.zeros(3), where=before > 0)
        blocks.map(turn, n, beta, z, p)
        pLp = _total(blocks.map(multiply, n, *L, p, Lp))
        alpha = np.divide(rz, pLp, out=np.zeros(3), where=(pLp > 0) & (rz > enough))
        blocks.map(advance, n, alpha, p, Lp, x, r, z)
    return x, most


def _total(parts: list[tuple[float, float, float]]) -> Floats:
    return np.array(parts).sum(axis=0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def products(low: int, high: int, r: Floats, z: Singles) -> tuple[float, float, float]:
    """The products of the columns of r and z (n, 3) over the rows low..high."""
    s0 = s1 = s2 = 0.0
    for v in range(low, high):
        s0 += r[v, 0] * z[v, 0]
        s1 += r[v, 1] * z[v, 1]
        s2 += r[v, 2] * z[v, 2]
    return s0, s1, s2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def turn(low: int, high: int, beta: Floats, z: Singles, p: Singles) -> None:
    """p <- z + beta p in place, both (n, 3), over the rows low..high."""
    for v in range(low, high):
        for c in range(3):
            p[v, c] = z[v, c] + beta[c] * p[v, c]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def multiply(
    low: int,
    high: int,
    first: Ints,
    neighbour: Scans32,
    weight: Floats,
    degree: Floats,
    p: Singles,
    Lp: Floats,
) -> tuple[float, float, float]:
    """Lp <- Laplacian p, both (n, 3), and the products of their columns, over the rows low..high.

    The Laplacian: `first` (n + 1,), `neighbour` (2m,), `weight` (2m,), `degree` (n,), as in `Laplacian`.
    """
    t0 = t1 = t2 = 0.0
    for v in range(low, high):
        s0, s1, s2 = degree[v] * p[v, 0], degree[v] * p[v, 1], degree[v] * p[v, 2]
        for a in range(first[v], first[v + 1]):
            u, w = neighbour[a], weight[a]
            s0 -= w * p[u, 0]
            s1 -= w * p[u, 1]
            s2 -= w * p[u, 2]
        Lp[v, 0], Lp[v, 1], Lp[v, 2] = s0, s1, s2
        t0 += p[v, 0] * s0
        t1 += p[v, 1] * s1
        t2 += p[v, 2] * s2
    return t0, t1, t2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def advance(low: int, high: int, alpha: Floats, p: Singles, Lp: Floats, x: Floats, r: Floats, z: Singles) -> None:
    """x <- x + alpha p, r <- r - alpha Lp, z <- r in place, all (n, 3), over the rows low..high."""
    for v in range(low, high):
        for c in range(3):
            x[v, c] += alpha[c] * p[v, c]
            r[v, c] -= alpha[c] * Lp[v, c]
            z[v, c] = r[v, c]
