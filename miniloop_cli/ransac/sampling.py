"""Minimal samples from distance-consistent matches.

A rigid motion keeps distances, so two true matches (p1, q1), (p2, q2) have | |p1 - p2| - |q1 - q2| | small. Checking
this before any solving rejects nearly every contaminated sample: at 60 % inliers, ten independent draws are all inliers
with a probability of 0.6 %. With a known vertical, heights and horizontal distances are kept.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.ransac.matches import Packed
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats, Ints

TRIES = 256  # draws before an edge is given up for this hypothesis


@njit(cache=True, nogil=True, error_model="numpy")
def spread_m(X: Floats, first: int, last: int, axes: int) -> float:
    """RMS distance of the columns first to last of X (3, n) from their mean, over `axes` axes; 0 without points."""
    count = last - first
    total = 0.0
    for axis in range(axes):
        mean = 0.0
        for k in range(first, last):
            mean += X[axis, k]
        mean /= max(count, 1)
        for k in range(first, last):
            total += (X[axis, k] - mean) ** 2
    return np.sqrt(total / max(count, 1))


@njit(cache=True, nogil=True, error_model="numpy")
def _consistent(P: Floats, Q: Floats, a: int, b: int, tolerance: float, min_baseline: float, upright: bool) -> bool:
    px, py, pz = P[0, a] - P[0, b], P[1, a] - P[1, b], P[2, a] - P[2, b]
    qx, qy, qz = Q[0, a] - Q[0, b], Q[1, a] - Q[1, b], Q[2, a] - Q[2, b]
    if upright:
        if abs(pz - qz) > tolerance:
            return False
        pz = qz = 0.0
    dp, dq = np.sqrt(px * px + py * py + pz * pz), np.sqrt(qx * qx + qy * qy + qz * qz)
    # A short baseline gives an inaccurate axis: a small displacement becomes a large angle.
    return abs(dp - dq) < tolerance and min(dp, dq) > min_baseline


@njit(cache=True, nogil=True, error_model="numpy")
def _draw(
    matches: Packed,
    tolerance: Floats,
    first: int,
    last: int,
    size: int,
    min_baseline: float,
    upright: bool,
    rng: np.random.Generator,
    sample: Ints,
) -> bool:
    """Draw `size` (1 to 3) mutually consistent matches from [first, last) into sample[:size]; False if none found."""
    count = last - first
    if count < size:
        return False
    for _ in range(TRIES):
        good = True
        for s in range(size):
            a = first + int(rng.random() * count)
            sample[s] = a
            for r in range(s):
                b = sample[r]
                limit = tolerance[a] + tolerance[b]
                if a == b or not _consistent(matches.P, matches.Q, a, b, limit, min_baseline, upright):
                    good = False
            if not good:
                break
        if good:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def draw_samples(
    matches: Packed,
    tolerance: Floats,
    sizes: Ints,
    baseline_share: float,
    upright: bool,
    rng: np.random.Generator,
    samples: Ints,
    p: Floats,
    q: Floats,
) -> None:
    """Fill samples (b, k) with columns of `matches` and p, q (b, k, 3) with their points, sizes[e] of each edge e.

    tolerance (N,) metres a match; two matches of a sample are at least `baseline_share` of the spread of the edge's
    points apart. A sample for which an edge yields nothing is -1 and its points are zero, which no solver solves.
    """
    edges = sizes.shape[0]
    axes = 2 if upright else 3
    baseline = np.empty(edges)
    for e in range(edges):
        first, last = matches.start[e], matches.start[e + 1]
        baseline[e] = baseline_share * min(
            spread_m(matches.P, first, last, axes), spread_m(matches.Q, first, last, axes)
        )
    for b in range(samples.shape[0]):
        filled = 0
        for e in range(edges):
            good = _draw(
                matches, tolerance, matches.start[e], matches.start[e + 1], sizes[e], baseline[e], upright, rng,
                samples[b, filled:],
            )  # fmt: skip
            if not good:
                samples[b, :] = -1
                break
            filled += sizes[e]
        for s in range(samples.shape[1]):
            for axis in range(3):
                k = samples[b, s]
                p[b, s, axis] = matches.P[axis, k] if k >= 0 else 0.0
                q[b, s, axis] = matches.Q[axis, k] if k >= 0 else 0.0
