"""The search: sample, solve, score, refine, for a pair and for cycles alike, in one compiled loop."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from miniloop_cli.ransac.sampling import draw, spread_m
from miniloop_cli.ransac.system import compose, gauss_newton
from miniloop_cli.solvers import cycle3, cycle4, cycle5, pairwise

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BLOCK = 64  # matches scored between two looks at whether the hypothesis can still win
MATH = {"nnan", "ninf", "nsz", "arcp", "contract", "reassoc"}
PAIR, CYCLE3, CYCLE4, CYCLE5 = 2, 3, 4, 5  # solver numbers: scans of the cycle


@njit(cache=True, nogil=True, fastmath=MATH)
def score(
    T: Floats, P: Floats, Q: Floats, inverse_gate2: Floats, first: int, last: int, soft: float, bound: float
) -> float:
    """Truncated cost of the matches [first, last) under the pose T (3, 4); stops once it exceeds `bound`.

    A match costs min(|T p - q|^2 / gate^2, 1) where soft = 1 (MSAC), and 0 or 1 where soft = 0 (counting).
    """
    R00, R01, R02, t0 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    R10, R11, R12, t1 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    R20, R21, R22, t2 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    total = 0.0
    for block in range(first, last, BLOCK):
        part = 0.0
        for k in range(block, min(block + BLOCK, last)):
            x, y, z = P[0, k], P[1, k], P[2, k]
            r0 = R00 * x + R01 * y + R02 * z + t0 - Q[0, k]
            r1 = R10 * x + R11 * y + R12 * z + t1 - Q[1, k]
            r2 = R20 * x + R21 * y + R22 * z + t2 - Q[2, k]
            ratio = min((r0 * r0 + r1 * r1 + r2 * r2) * inverse_gate2[k], 1.0)
            part += soft * ratio + (1.0 - soft) * np.floor(ratio)
        total += part
        if total > bound:
            break
    return total


@njit(cache=True, nogil=True)
def score_cycle(
    T: Floats, P: Floats, Q: Floats, inverse_gate2: Floats, start: Ints, soft: float, bound: float
) -> float:
    """Cost of all edges, the closing edge (scored first: only it sees the whole chain) through the composed poses."""
    chain = T.shape[0]
    total = 0.0
    if chain > 1:
        total = score(compose(T), P, Q, inverse_gate2, start[chain], start[chain + 1], soft, bound)
    for e in range(chain):
        if total <= bound:
            total += score(T[e], P, Q, inverse_gate2, start[e], start[e + 1], soft, bound - total)
    return total


@njit(cache=True, nogil=True)
def solve(kind: int, p: Floats, q: Floats, T: Floats) -> int:
    """The minimal solver of this kind: (k, 3) matches to T (solutions, n-1, 3, 4); returns the number of solutions."""
    if kind == PAIR:
        return pairwise.solve(p, q, T)
    if kind == CYCLE3:
        return cycle3.solve(p, q, T)
    if kind == CYCLE4:
        return cycle4.solve(p, q, T)
    return cycle5.solve(p, q, T)


@njit(cache=True, nogil=True)
def _all_inlier_share(
    T: Floats, P: Floats, Q: Floats, inverse_gate2: Floats, start: Ints, sizes: Ints, acceptance: Floats
) -> float:
    """Probability that a consistent sample is all inliers, from the inliers of T and the share of draws accepted."""
    chain = T.shape[0]
    share = 1.0
    for e in range(start.shape[0] - 1):
        pose = T[e] if e < chain else compose(T)
        count = start[e + 1] - start[e]
        inliers = count - score(pose, P, Q, inverse_gate2, start[e], start[e + 1], 0.0, np.inf)
        edge_share = 1.0
        for s in range(sizes[e]):
            edge_share *= max(inliers - s, 0.0) / max(count - s, 1)
        share *= min(edge_share / acceptance[e], 1.0)
    return share


@njit(cache=True, nogil=True)
def search(
    kind: int,
    solutions: int,
    P: Floats,
    Q: Floats,
    CP: Floats,
    CQ: Floats,
    start: Ints,
    sizes: Ints,
    inverse_gate2: Floats,
    soft: float,
    upright: bool,
    iterations: int,
    confidence: float,
    refine: int,
    rng: np.random.Generator,
    edge_H: Floats,
) -> tuple[bool, Floats, float, int]:
    """Best poses of a cycle; returns (found, T (n-1, 3, 4), cost, hypotheses tried).

    P, Q (3, N) points (m) and CP, CQ (6, N) covariances, matches of edge e in [start[e], start[e + 1]), the closing
    edge last; sizes: matches an edge gives to a sample; inverse_gate2 (N,) 1 / inlier distance^2 (1/m^2).
    `refine`: Gauss-Newton steps on every new best (0: none). `confidence` 1: always `iterations` hypotheses.
    """
    edges = sizes.shape[0]
    chain = max(edges - 1, 1)
    tolerance = 0.7 / np.sqrt(inverse_gate2)
    gate2 = 1.0 / np.min(inverse_gate2)
    baseline = np.empty(edges)
    for e in range(edges):
        baseline[e] = 0.5 * spread_m(P, start[e], start[e + 1])
    total = sizes.sum()
    sample, p, q = np.empty(total, np.int64), np.empty((total, 3)), np.empty((total, 3))
    T = np.zeros((solutions, chain, 3, 4))
    best, best_cost, found = np.zeros((chain, 3, 4)), np.inf, False
    draws, accepted, acceptance = np.ones(edges), np.ones(edges), np.ones(edges)
    needed, tried = iterations, 0
    while tried < needed:
        tried += 1
        filled = 0
        for e in range(edges):
            attempts = draw(P, Q, tolerance, start[e], start[e + 1], sizes[e], baseline[e], rng, sample[filled:])
            if attempts == 0:
                filled = -1
                break
            draws[e] += attempts
            accepted[e] += 1
            filled += sizes[e]
        if filled < 0:
            continue
        for s in range(total):
            for axis in range(3):
                p[s, axis], q[s, axis] = P[axis, sample[s]], Q[axis, sample[s]]
        improved = False
        for s in range(solve(kind, p, q, T)):
            cost = score_cycle(T[s], P, Q, inverse_gate2, start, soft, best_cost)
            if cost < best_cost:
                best_cost, found, improved = cost, True, True
                best[:] = T[s]
        if improved:
            if refine > 0:
                # Graduated: first as if every match were as uncertain as the gate allows, then by its own noise.
                trial = best.copy()
                for inflation2 in (gate2 / 9, 0.0):
                    if gauss_newton(trial, P, Q, CP, CQ, start, inflation2, 4 * gate2, 9.0, upright, refine, edge_H):
                        cost = score_cycle(trial, P, Q, inverse_gate2, start, soft, best_cost)
                        if cost < best_cost:
                            best_cost = cost
                            best[:] = trial
            if confidence < 1.0:
                acceptance[:] = accepted / draws
                share = _all_inlier_share(best, P, Q, inverse_gate2, start, sizes, acceptance)
                if share > 0:
                    # A minimal sample of inliers is not yet a good pose: ask for three of them.
                    wanted = 3 * np.log(1.0 - confidence) / np.log(max(1.0 - share, 1e-12))
                    needed = min(iterations, max(int(wanted) + 1, 20))
    return found, best, best_cost, tried
