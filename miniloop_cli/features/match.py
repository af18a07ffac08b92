"""Exact mutual nearest neighbours with the ratio test: all distances of a row, one pass over them.

The pass keeps the best and second-best of a row in independent lanes, and the best of every column. It uses only minima
and maxima and therefore vectorises. Indices are found afterwards, for the few rows that pass the ratio test.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Bytes, Floats32, Ints

LANES = 16
INFINITE_DISTANCE = np.float32(3e38)
# There is no NaN, and the sign of zero does not matter; minima vectorise only under these two assumptions.
# Reassociation stays forbidden, so that a distance has the same bits each time it is computed.
MATH = {"nnan", "nsz"}


def match(a: NDArray, b: NDArray, ratio: float = 0.8) -> Ints:
    """Mutual nearest neighbours of two descriptor sets that pass the ratio test on the first set's side.

    a (n, d), b (m, d): both float32 (Euclidean distance) or both uint8 (Hamming distance over packed bits).
    Returns (k, 2) int64 index pairs, sorted by the first index: the same as OpenCV's brute-force matcher with
    `knnMatch(k=2)`, Lowe's ratio and a cross check. If several rows are equally near to a column, as is frequent with
    bits, the first that passes the ratio test is matched.
    """
    if len(a) < 1 or len(b) < 2:
        return np.zeros((0, 2), np.int64)
    if a.dtype == np.uint8:
        return _match_bits(_words(a), np.ascontiguousarray(_words(b).T), np.float32(ratio))
    norms_a, norms_b = np.einsum("ij,ij->i", a, a), np.einsum("ij,ij->i", b, b)
    return _match_products(a @ (-2 * b).T, norms_a, norms_b, np.float32(ratio * ratio))


def _words(bits: Bytes) -> NDArray[np.uint64]:
    """(n, bytes) to (n, ceil(bytes / 8)) words; padding is zero on both sides and adds no distance."""
    padded = np.pad(bits, ((0, 0), (0, -bits.shape[1] % 8)))
    return np.ascontiguousarray(padded).view(np.uint64)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=MATH, inline="always")
def _top2(d: Floats32, column: Floats32, lane1: Floats32, lane2: Floats32) -> tuple[np.float32, np.float32]:
    """Best and second-best of the distances d (m,); column (m,) becomes the minimum of itself and d."""
    m = d.shape[0]
    whole = m - m % LANES
    lane1[:] = INFINITE_DISTANCE
    lane2[:] = INFINITE_DISTANCE
    for j0 in range(0, whole, LANES):
        for k in range(LANES):
            x = d[j0 + k]
            column[j0 + k] = min(column[j0 + k], x)
            lane2[k] = min(lane2[k], max(lane1[k], x))
            lane1[k] = min(lane1[k], x)
    best, second = INFINITE_DISTANCE, INFINITE_DISTANCE
    for k in range(LANES):
        second = min(max(best, lane1[k]), second, lane2[k])
        best = min(best, lane1[k])
    for j in range(whole, m):
        x = d[j]
        column[j] = min(column[j], x)
        second = min(second, max(best, x))
        best = min(best, x)
    return best, second


@njit(cache=True, nogil=True, error_model="numpy", fastmath=MATH, inline="always")
def _mutual(d: Floats32, best: np.float32, column: Floats32) -> int:
    """The column whose distance is the row's best and its own best, taken once; -1 if there is none."""
    for j in range(d.shape[0]):
        if d[j] <= best:
            if d[j] <= column[j]:
                column[j] = np.float32(-1)
                return j
            return -1
    return -1


@njit(cache=True, nogil=True, error_model="numpy", fastmath=MATH)
def _match_products(products: Floats32, norms_a: Floats32, norms_b: Floats32, ratio2: np.float32) -> Ints:
    """products (n, m) float32 = -2 a b^T, squared norms (n,), (m,) float32 -> (k, 2) int64."""
    n, m = products.shape
    best, second = np.empty(n, np.float32), np.empty(n, np.float32)
    column, lane1, lane2 = np.full(m, INFINITE_DISTANCE), np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    for i in range(n):
        d = products[i]
        for j in range(m):
            d[j] += norms_a[i] + norms_b[j]
        best[i], second[i] = _top2(d, column, lane1, lane2)
    out, count = np.empty((n, 2), np.int64), 0
    for i in range(n):
        # Rounding can make the squared distance of equal descriptors negative.
        if max(best[i], np.float32(0)) < ratio2 * second[i]:
            j = _mutual(products[i], best[i], column)
            if j >= 0:
                out[count, 0], out[count, 1] = i, j
                count += 1
    return out[:count].copy()


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _popcount(x: np.uint64) -> np.uint64:
    """Set bits of a uint64; the compiler knows this idiom and emits the machine's own instruction."""
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=MATH)
def _hamming_row(a: NDArray[np.uint64], b: NDArray[np.uint64], d: Floats32) -> None:
    """Distances d (m,) float32 of the words a (w,) to the columns of b (w, m)."""
    d[:] = np.float32(0)
    for w in range(a.shape[0]):
        for j in range(d.shape[0]):
            d[j] += np.float32(np.int64(_popcount(a[w] ^ b[w, j])))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=MATH)
def _match_bits(a: NDArray[np.uint64], b: NDArray[np.uint64], ratio: np.float32) -> Ints:
    """a (n, w), b (w, m) uint64 -> (k, 2) int64."""
    n, m = a.shape[0], b.shape[1]
    best, second, d = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(m, np.float32)
    column, lane1, lane2 = np.full(m, INFINITE_DISTANCE), np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    for i in range(n):
        _hamming_row(a[i], b, d)
        best[i], second[i] = _top2(d, column, lane1, lane2)
    out, count = np.empty((n, 2), np.int64), 0
    for i in range(n):
        if best[i] < ratio * second[i]:
            _hamming_row(a[i], b, d)
            j = _mutual(d, best[i], column)
            if j >= 0:
                out[count, 0], out[count, 1] = i, j
                count += 1
    return out[:count].copy()
