"""How well hypotheses fit all edges of a pair or a cycle, and how likely a sample is clean."""

from __future__ import annotations

import numpy as np

from miniloop_cli.ransac.gauss_newton import WHOLE, compose_into
from miniloop_cli.ransac.matches import Packed
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats, Ints

BLOCK = 64  # matches scored between two checks whether the hypothesis can still win


@njit(**WHOLE, inline="always")
def score(T: Floats, matches: Packed, inverse_gate2: Floats, first: int, last: int, soft: float, bound: float) -> float:
    """Truncated cost of the matches [first, last) under the pose T (3, 4); stops once it exceeds `bound`.

    inverse_gate2 (matches,) 1/m^2: the inverse square of each match's gate. A match costs min(|T p - q|^2 / gate^2, 1)
    where soft = 1 (MSAC), and 0 or 1 where soft = 0 (counting).
    """
    P, Q = matches.P, matches.Q
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


@njit(**WHOLE, inline="always")
def score_cycle(
    T: Floats, matches: Packed, inverse_gate2: Floats, soft: float, bound: float, floors: Floats, closing: Floats
) -> float:
    """Cost of all edges, the closing edge (scored first: only it sees the whole chain) through the composed poses.

    T (n-1, 3, 4); inverse_gate2 (matches,) as in `score`; closing (3, 4) is workspace. floors (edges,), updated: the
    least cost of each edge so far, infinite at first. Scoring stops once the cost of the scored edges, plus the floors
    of the rest, exceeds `bound`.
    """
    chain, edges = T.shape[0], matches.start.shape[0] - 1
    left = 0.0
    for e in range(edges):
        left += floors[e] if floors[e] < np.inf else 0.0
    total = 0.0
    for position in range(edges):
        e = (position + edges - 1) % edges
        pose = T[min(e, chain - 1)]
        if e == chain:
            compose_into(T, closing)
            pose = closing
        left -= floors[e] if floors[e] < np.inf else 0.0
        first, last, most = matches.start[e], matches.start[e + 1], bound - total - left
        cost = score(pose, matches, inverse_gate2, first, last, soft, most)
        total += cost
        if cost > most:
            return max(total + left, bound)
        floors[e] = min(floors[e], cost)
    return total


@njit(**WHOLE)
def best_of(
    T: Floats, counts: Ints, matches: Packed, inverse_gate2: Floats, soft: float, floors: Floats, best: Floats
) -> float:
    """The cheapest of the hypotheses T (b, solutions, n-1, 3, 4), counts (b,), is copied to best (n-1, 3, 4).

    Returns its cost, infinite if there is no hypothesis. inverse_gate2 (matches,) and floors (edges,) as in
    `score_cycle`.
    """
    closing, best_cost = np.empty((3, 4)), np.inf
    for b in range(T.shape[0]):
        for s in range(counts[b]):
            cost = score_cycle(T[b, s], matches, inverse_gate2, soft, best_cost, floors, closing)
            if cost < best_cost:
                best_cost = cost
                for e in range(T.shape[2]):
                    for i in range(3):
                        for j in range(4):
                            best[e, i, j] = T[b, s, e, i, j]
    return best_cost


@njit(cache=True, nogil=True, error_model="numpy")
def inlier_sample_share(T: Floats, matches: Packed, inverse_gate2: Floats, samples: Ints, sizes: Ints) -> float:
    """Probability that a sample holds inliers of T (n-1, 3, 4) only: the product over the edges of their own shares.

    samples (b, k) as they were drawn, `sizes` (edges,) matches an edge: the distance check of the sampling is thereby
    taken into account. inverse_gate2 (matches,) as in `score`.
    """
    closing = np.empty((3, 4))
    compose_into(T, closing)
    inlier = np.empty(matches.P.shape[1], np.bool_)
    for e in range(sizes.shape[0]):
        pose = T[e] if e < T.shape[0] else closing
        for k in range(matches.start[e], matches.start[e + 1]):
            inlier[k] = score(pose, matches, inverse_gate2, k, k + 1, 0.0, np.inf) < 1.0
    share, filled = 1.0, 0
    for e in range(sizes.shape[0]):
        clean, drawn = 0, 0
        for b in range(samples.shape[0]):
            if samples[b, filled] < 0:
                continue
            drawn += 1
            inside = 0
            for s in range(filled, filled + sizes[e]):
                inside += inlier[samples[b, s]]
            clean += inside == sizes[e]
        filled += sizes[e]
        share *= clean / max(drawn, 1)
    return share
