"""Minimal samples from distance-consistent matches.

A rigid motion keeps distances, so two true matches (p1, q1), (p2, q2) have | |p1 - p2| - |q1 - q2| | small. Checking
this before any solving rejects nearly every contaminated sample: at 60 % inliers ten free draws are all inliers in
0.6 % of cases, five consistent pairs in most.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

TRIES = 64  # draws before an edge is given up for this hypothesis


@njit(cache=True, nogil=True)
def spread_m(P: Floats, first: int, last: int) -> float:
    """Root mean square distance of the points P[:, first:last] from their mean."""
    count = last - first
    total = 0.0
    for axis in range(3):
        mean = 0.0
        for k in range(first, last):
            mean += P[axis, k]
        mean /= count
        for k in range(first, last):
            total += (P[axis, k] - mean) ** 2
    return np.sqrt(total / count)


@njit(cache=True, nogil=True)
def _consistent(P: Floats, Q: Floats, a: int, b: int, tolerance: Floats, min_baseline: float) -> bool:
    dp = np.sqrt((P[0, a] - P[0, b]) ** 2 + (P[1, a] - P[1, b]) ** 2 + (P[2, a] - P[2, b]) ** 2)
    dq = np.sqrt((Q[0, a] - Q[0, b]) ** 2 + (Q[1, a] - Q[1, b]) ** 2 + (Q[2, a] - Q[2, b]) ** 2)
    # A short baseline is a bad axis: it turns a small displacement into a large angle.
    return abs(dp - dq) < tolerance and min(dp, dq) > min_baseline


@njit(cache=True, nogil=True)
def draw(
    P: Floats,
    Q: Floats,
    tolerance: Floats,
    first: int,
    last: int,
    size: int,
    min_baseline: float,
    rng: np.random.Generator,
    sample: Ints,
) -> int:
    """Draw `size` (1 to 3) mutually consistent matches from [first, last) into sample[:size].

    P, Q (3, N) metres, tolerance (N,) metres a match. Returns the number of draws it took, or 0 if none was found.
    """
    count = last - first
    if count < size:
        return 0
    for attempt in range(1, TRIES + 1):
        for s in range(size):
            sample[s] = first + int(rng.random() * count)
        good = True
        for s in range(size):
            for r in range(s):
                a, b = sample[s], sample[r]
                if a == b or not _consistent(P, Q, a, b, tolerance[a] + tolerance[b], min_baseline):
                    good = False
        if good:
            return attempt
    return 0
