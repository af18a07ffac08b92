"""Fast matching: sketches of the descriptors select a few neighbours, which are then compared exactly.

A sketch is the signs of the descriptor under random directions (Charikar, "Similarity estimation techniques from
rounding algorithms", STOC 2002): the nearer two descriptors, the fewer signs differ, and counting differing bits is
much cheaper than a distance. For each feature, the CANDIDATES with fewest differing bits, at most one in each lane of
columns, are compared exactly, and the ratio test is between those.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.features.hamming import WORDS, set_bits
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Bytes, Floats32, Ints

Bits = NDArray[np.uint32]

LANES = 16  # columns compared at once; each keeps its best
CANDIDATES = 8
MAX_FEATURES = 1 << 16  # features of a scan, limited by the bits of a key


@dataclass(frozen=True)
class Sketched:
    """Features ready for `match_sketched`: descriptors (n, d) uint8 and their sketches.

    rows: (n, WORDS); blocks: the same as (ceil(n / LANES), WORDS, LANES), zeros at the end.
    """

    descriptors: Bytes
    rows: Bits
    blocks: Bits


@dataclass(frozen=True)
class Sketcher:
    """Makes comparable sketches: signs about the mean (d,) along directions (d, 32 WORDS)."""

    mean: Floats32
    directions: Floats32

    @staticmethod
    def of(descriptors: Sequence[Bytes]) -> Sketcher:
        """For the (n, d) compact descriptors of the scans of a recording."""
        strongest = [found[:200] for found in descriptors if len(found)]
        mean = np.concatenate(strongest).mean(axis=0).astype(np.float32) if strongest else np.zeros(1, np.float32)
        return Sketcher(mean, _directions(len(mean)))

    def sketched(self, descriptors: Bytes) -> Sketched:
        """Compact descriptors (n, d) of one scan, the first MAX_FEATURES of them."""
        found = descriptors[:MAX_FEATURES]
        n = len(found)
        signs = (found - self.mean) @ self.directions > 0 if n else np.zeros((0, 32 * WORDS), bool)
        rows = np.ascontiguousarray(np.packbits(signs, axis=1)).view(np.uint32)
        padded = np.pad(rows, ((0, -n % LANES), (0, 0)))
        return Sketched(found, rows, np.ascontiguousarray(padded.reshape(-1, LANES, WORDS).transpose(0, 2, 1)))


def sketch(descriptors: Sequence[Bytes]) -> list[Sketched]:
    """Sketches of the (n, d) compact descriptors of each scan of a recording, about the recording's mean."""
    sketcher = Sketcher.of(descriptors)
    return [sketcher.sketched(found) for found in descriptors]


def _directions(d: int) -> Floats32:
    """(d, 32 WORDS) directions, orthogonal within each group of d."""
    rng, count = np.random.default_rng(0), 32 * WORDS
    groups = [np.linalg.qr(rng.standard_normal((d, d)))[0] for _ in range(-(-count // d))]
    return np.hstack(groups)[:, :count].astype(np.float32)


def match_sketched(a: Sketched, b: Sketched, count: int, ratio2: float) -> Ints:
    """Matches (k, 2) of the first `count` features of a and b, sorted; `ratio2` bounds the ratio of squared distances.

    Nearly those of `match`, but mutual among the candidates only; and the ratio test passes more matches if the second
    nearest is not a candidate.
    """
    n, m = min(len(a.rows), count), min(len(b.rows), count)
    if n < 1 or m < 2:
        return np.zeros((0, 2), np.int64)
    return _match(a.descriptors, b.descriptors, a.rows[:n], b.blocks, m, ratio2)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _differing(row: Bits, block: Bits, k: int) -> np.uint32:
    """Bits in which a sketch differs from the k-th of a block."""
    return set_bits(
        np.uint32(row[0] ^ block[0, k]),
        np.uint32(row[1] ^ block[1, k]),
        np.uint32(row[2] ^ block[2, k]),
        np.uint32(row[3] ^ block[3, k]),
        np.uint32(row[4] ^ block[4, k]),
        np.uint32(row[5] ^ block[5, k]),
        np.uint32(row[6] ^ block[6, k]),
        np.uint32(row[7] ^ block[7, k]),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(rows: Bits, blocks: Bits, m: int, lane: Bits, column: Bits) -> None:
    """Keys (differing bits, number) of the best of each lane for every row (n, LANES), and of every column's row."""
    shift = np.uint32(16)
    whole = m // LANES
    for i in range(rows.shape[0]):
        number, best = np.uint32(i), lane[i]
        for block in range(whole):
            at = np.uint32(block * LANES)
            for k in range(LANES):
                differing = np.uint32(_differing(rows[i], blocks[block], k) << shift)
                column[block, k] = min(column[block, k], np.uint32(differing | number))
                best[k] = min(best[k], np.uint32(differing | np.uint32(at + np.uint32(k))))
        for k in range(m - whole * LANES):
            differing = np.uint32(_differing(rows[i], blocks[whole], k) << shift)
            column[whole, k] = min(column[whole, k], np.uint32(differing | number))
            best[k] = min(best[k], np.uint32(differing | np.uint32(whole * LANES + k)))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _least(keys: Bits) -> np.uint32:
    """The least of the keys (LANES,), which is removed."""
    least = np.uint32(0xFFFFFFFF)
    for k in range(LANES):
        least = min(least, keys[k])
    for k in range(LANES):
        keys[k] = np.uint32(0xFFFFFFFF) if keys[k] == least else keys[k]
    return least


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def squared_distance(a: Bytes, b: Bytes) -> np.int32:
    """Of two compact descriptors a (d,) and b (d,); for compiled code."""
    total = np.int32(0)
    for d in range(a.shape[0]):
        difference = np.int16(np.int16(a[d]) - np.int16(b[d]))  # every cast: numba would widen to 64 bits
        total = np.int32(total + np.int32(np.int32(difference) * np.int32(difference)))
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _match(a: Bytes, b: Bytes, rows: Bits, blocks: Bits, m: int, ratio2: float) -> Ints:
    n = rows.shape[0]
    none = np.uint32(0xFFFFFFFF)
    lane = np.full((n, LANES), none, np.uint32)
    column = np.full((-(-m // LANES), LANES), none, np.uint32)
    _nearest(rows, blocks, m, lane, column)
    match, distance2 = np.full(n, -1), np.empty(n, np.int32)
    taken, taken_by = np.full(m, np.int32(2**31 - 1), np.int32), np.full(m, -1)
    for i in range(n):
        nearest: int | np.int64 = -1
        best, second = np.int32(2**31 - 1), np.int32(2**31 - 1)
        for _ in range(CANDIDATES):
            key = _least(lane[i])
            if key == none:
                break
            j = np.int64(key & np.uint32(0xFFFF))
            d2 = squared_distance(a[i], b[j])
            if d2 < best:
                nearest, best, second = j, d2, best
            else:
                second = min(second, d2)
        if best < ratio2 * second:
            rival = np.int64(column[nearest // LANES, nearest % LANES] & np.uint32(0xFFFF))
            if rival != i and squared_distance(a[rival], b[nearest]) < best:
                continue
            match[i], distance2[i] = nearest, best
            if best < taken[nearest]:
                taken[nearest], taken_by[nearest] = best, i
    out, count = np.empty((n, 2), np.int64), 0
    for i in range(n):
        if match[i] >= 0 and taken_by[match[i]] == i:
            out[count, 0], out[count, 1] = i, match[i]
            count += 1
    return out[:count].copy()
