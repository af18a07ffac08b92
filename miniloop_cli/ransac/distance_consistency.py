"""Which matches of a pair can be inliers of one rigid motion.

Two inliers keep their distance, so k inliers are mutually consistent: each is in the (k - 1)-core of the graph that
joins consistent matches. Matches outside the core are dropped before sampling, and a pair with an empty core cannot
have k inliers. Most false pairs of scans, whose few matches are not consistent, need no sampling at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.typing import Bools, Floats, Ints, Pair

if TYPE_CHECKING:
    pass
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.points import ScanPoints


@njit(cache=True, nogil=True, error_model="numpy")
def consistent_core(P: Floats, Q: Floats, tolerance: Floats, k: int) -> Bools:
    """Members (m,) bool of the k-core: each is consistent with at least k others of the core.

    P, Q (3, m) matched points (m); two matches are consistent if their distances in both scans differ by less than
    the sum of their tolerances (m,) metres.
    """
    m = P.shape[1]
    joined = np.zeros((m, m), np.bool_)
    degree = np.zeros(m, np.int64)
    for a in range(m):
        for b in range(a):
            dp = np.sqrt((P[0, a] - P[0, b]) ** 2 + (P[1, a] - P[1, b]) ** 2 + (P[2, a] - P[2, b]) ** 2)
            dq = np.sqrt((Q[0, a] - Q[0, b]) ** 2 + (Q[1, a] - Q[1, b]) ** 2 + (Q[2, a] - Q[2, b]) ** 2)
            if abs(dp - dq) < tolerance[a] + tolerance[b]:
                joined[a, b] = True
                joined[b, a] = True
                degree[a] += 1
                degree[b] += 1
    core = np.ones(m, np.bool_)
    changed = True
    while changed:
        changed = False
        for a in range(m):
            if core[a] and degree[a] < k:
                core[a] = False
                changed = True
                for b in range(m):
                    if joined[a, b]:
                        degree[b] -= 1
    return core


def consistent(points: Sequence[ScanPoints], pair: Pair, rows: Ints, threshold_m: float, least: int) -> Bools:
    """Matches (m,) bool whose distances agree with those of at least `least` others, see `consistent_core`.

    Two matches agree if their distances differ by less than `threshold_m` and three sigma of both.
    """
    a, b = points[pair[0]], points[pair[1]]
    tolerance = 0.5 * threshold_m + 1.5 * np.hypot(a.sigmas_m[rows[:, 0]], b.sigmas_m[rows[:, 1]])
    P, Q = (np.ascontiguousarray(side.points_m[rows[:, k]].T) for k, side in enumerate((a, b)))
    return consistent_core(P, Q, tolerance, least)
