"""A preconditioner for graph Laplacians of any shape and weights: Gaussian elimination with sampled fill.

Eliminating a scan v with neighbours of weights w_1 <= .. <= w_k (sum W) exactly would join each two of them by an
edge w_a w_b / W: a clique, which causes fill. Instead each neighbour a < k gets one edge, of weight w_a s_a / W with
s_a = w_{a+1} + .. + w_k, to a neighbour b > a drawn with probability w_b / s_a. This tree equals the clique in the
mean, and the number of edges never grows. Gao, Kyng & Spielman, "Robust and practical solution of Laplacian equations
by approximate elimination", 2023.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats, Ints

Scans32 = NDArray[np.uint32]
Singles = NDArray[np.float32]
Factor = tuple[Scans32, Ints, Scans32, Singles, Singles]
"""`order` (n,) scans as eliminated; column c of L: `start` (n+1,), `row` (scans), `value`; `D` (n,).

Rows are scans, not places in the order: those that follow each other in time lie near each other in memory.
`order` and `row` are unsigned with 32 bits, `value` and `D` in single precision: a preconditioner needs few digits, and
what it costs is the reading of memory."""


def sampling_numbers() -> Floats:
    """(99991,) numbers in [0, 1) for `eliminate`, the same for every graph: equal graphs get equal factors."""
    return np.random.default_rng(0).random(99991)


@njit(cache=True, nogil=True, error_model="numpy")
def _take(v: int, first: Ints, after: Ints, before: Ints, bucket: Ints) -> None:
    """Remove scan v from its bucket."""
    if before[v] >= 0:
        after[before[v]] = after[v]
    else:
        first[bucket[v]] = after[v]
    if after[v] >= 0:
        before[after[v]] = before[v]


@njit(cache=True, nogil=True, error_model="numpy")
def _put(v: int, degree: int, first: Ints, after: Ints, before: Ints, bucket: Ints) -> None:
    """Insert scan v at the front of bucket `degree`."""
    bucket[v] = degree
    before[v], after[v] = -1, first[degree]
    if first[degree] >= 0:
        before[first[degree]] = v
    first[degree] = v


@njit(cache=True, nogil=True, error_model="numpy")
def eliminate(count: int, pairs: Ints, weights: Floats, uniform: Floats) -> Factor:
    """Approximate L D L' of the Laplacian of pairs (m, 2), weights (m,) > 0, few edges first; D = 0 for the last scan.

    `uniform`: random numbers in [0, 1), used in turn and cyclically.
    """
    m = len(pairs)
    # Half-edge 2e lies in the list of pairs[e, 0] and leads to pairs[e, 1]; 2e + 1 the other way. -1: gone.
    to, value = np.empty(2 * m, dtype=np.int32), np.empty(2 * m)
    following, head = np.empty(2 * m, dtype=np.int32), np.full(count, -1)
    degree = np.zeros(count, dtype=np.int64)
    for h in range(2 * m):
        v = pairs[h >> 1, h & 1]
        to[h], value[h], following[h] = pairs[h >> 1, 1 - (h & 1)], weights[h >> 1], head[v]
        head[v] = h
        degree[v] += 1
    buckets = min(count, 2 * m) + 1
    first, bucket = np.full(buckets, -1), np.full(count, -1)
    after, before = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    for v in range(count):
        _put(v, min(degree[v], buckets - 1), first, after, before, bucket)

    order = np.empty(count, dtype=np.uint32)
    start, D = np.zeros(count + 1, dtype=np.int64), np.zeros(count, dtype=np.float32)
    row, entry = np.empty(2 * m + count, dtype=np.uint32), np.empty(2 * m + count, dtype=np.float32)
    mark = np.full(count, -1)
    near = np.empty(count, dtype=np.int64)
    suffix = np.empty(count + 1)
    lowest = drawn = 0
    for step in range(count):
        while first[lowest] < 0:
            lowest += 1
        v = first[lowest]
        _take(v, first, after, before, bucket)
        order[step] = v
        k = 0
        h = head[v]
        while h >= 0:
            u, ahead = to[h], following[h]
            if u >= 0:
                if mark[u] >= 0:
                    value[mark[u]] += value[h]
                    to[h ^ 1] = -1
                    degree[u] -= 1
                else:
                    mark[u] = h
                    near[k] = h
                    k += 1
            h = ahead
        gap = 1
        while 3 * gap < k:
            gap = 3 * gap + 1
        while gap > 0:  # Shell's sort, lightest first
            for a in range(gap, k):
                h, b = near[a], a
                while b >= gap and value[near[b - gap]] > value[h]:
                    near[b] = near[b - gap]
                    b -= gap
                near[b] = h
            gap //= 3
        suffix[k] = 0.0
        for a in range(k - 1, -1, -1):
            suffix[a] = suffix[a + 1] + value[near[a]]
        D[step] = suffix[0]
        at = start[step]
        start[step + 1] = at + k
        if at + k > len(row):
            room = (at + k) * 5 // 4
            more_row, more_entry = np.empty(room, dtype=np.uint32), np.empty(room, dtype=np.float32)
            for a in range(at):
                more_row[a], more_entry[a] = row[a], entry[a]
            row, entry = more_row, more_entry
        for a in range(k):
            row[at + a], entry[at + a] = to[near[a]], value[near[a]] / suffix[0]
            mark[to[near[a]]] = -1
        for a in range(k - 1):
            h = near[a]
            u = to[h]
            draw = uniform[drawn] * suffix[a + 1]
            drawn = (drawn + 1) % len(uniform)
            low, high = a + 1, k - 1
            while low < high:
                middle = (low + high + 1) // 2
                if suffix[middle] >= draw:
                    low = middle
                else:
                    high = middle - 1
            other = row[at + low]
            # The half-edge that led from u to v now leads to `other`; the one from v to u joins the list of `other`.
            to[h ^ 1] = other
            value[h] = value[h ^ 1] = value[h] * suffix[a + 1] / suffix[0]
            following[h] = head[other]
            head[other] = h
            degree[other] += 1
        if k > 0:
            u = to[near[k - 1]]
            to[near[k - 1] ^ 1] = -1
            degree[u] -= 1
        for a in range(k):
            u = row[at + a]
            d = min(degree[u], buckets - 1)
            if d != bucket[u]:
                _take(u, first, after, before, bucket)
                _put(u, d, first, after, before, bucket)
                lowest = min(lowest, d)
    total = start[count]
    return order, start, row[:total].copy(), entry[:total].copy(), D


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def apply(order: Scans32, start: Ints, row: Scans32, value: Singles, D: Singles, z: Singles) -> None:
    """z <- inverse of L D L' times z (n, 3) in place, up to a constant; z in single precision.

    The factor: scans in `order` (n,); columns of L from `start` (n + 1,) on, with `row` and `value` (entries,); D (n,).
    """
    n = len(order)
    for c in range(n):
        v = order[c]
        z0, z1, z2 = z[v, 0], z[v, 1], z[v, 2]
        for a in range(start[c], start[c + 1]):
            u, f = row[a], value[a]
            z[u, 0] += f * z0
            z[u, 1] += f * z1
            z[u, 2] += f * z2
    for c in range(n - 1, -1, -1):
        v = order[c]
        s = np.float32(1 / D[c]) if D[c] > 0 else np.float32(0)
        z0, z1, z2 = s * z[v, 0], s * z[v, 1], s * z[v, 2]
        for a in range(start[c], start[c + 1]):
            u, f = row[a], value[a]
            z0 += f * z[u, 0]
            z1 += f * z[u, 1]
            z2 += f * z[u, 2]
        z[v, 0], z[v, 1], z[v, 2] = z0, z1, z2
