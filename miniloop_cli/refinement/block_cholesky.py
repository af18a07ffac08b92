"""Sparse Cholesky factorisation of 6 x 6 blocks, and the blocks of the inverse inside its pattern.

Columns are eliminated in minimum-degree order. The factor's pattern is found once (Gilbert, Ng & Peyton 1994: column j
has the rows of A's column j and those of its children in the elimination tree); factorisation is left-looking. The
inverse Z follows column by column from the last (Takahashi, Fagan & Chin 1973; Erisman & Tinney 1975), only where L is
not zero: with s the rows below the diagonal of column j,
  Z_sj = -Z_ss L_sj L_jj^-1,   Z_jj = L_jj^-T L_jj^-1 - (L_sj L_jj^-1)^T Z_sj,
so that the covariances of all poses cost about as much as two factorisations, instead of a solve for each.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.view_graph import elimination_order
from miniloop_cli.typing import Floats, Ints

COPIED = 1 << 15  # blocks at a time


class BlockPattern:
    """Pattern of a symmetric matrix of m x m blocks, given by its upper blocks (r, c), r <= c, and of its factor."""

    def __init__(self, m: int, r: Ints, c: Ints) -> None:
        off = r != c
        self.order = elimination_order(m, np.stack([r[off], c[off]], axis=1))
        place = np.empty(m, np.int64)
        place[self.order] = np.arange(m)
        row, column = place[c], place[r]
        self._flipped = row < column
        row, column = np.maximum(row, column), np.minimum(row, column)
        self._by_column = np.lexsort((row, column))
        start = np.searchsorted(column[self._by_column], np.arange(m + 1))
        self.start, self.row = _factor_pattern(start, row[self._by_column])
        # Position of each given block in the factor: column `column`, ascending rows.
        key = np.repeat(np.arange(m), np.diff(self.start)) * m + self.row
        self._slot = np.searchsorted(key, column * m + row)

    @property
    def products(self) -> float:
        """About how many multiplications a factorisation takes."""
        below = np.diff(self.start) - 1.0
        return float(216 * (below**2).sum())

    def factor(self, blocks: Floats, kept: Ints | None = None) -> Floats:
        """The factor, (len(row), 6, 6) blocks L_ij^T column by column, of (k, 6, 6) blocks in the order given at first.

        `kept` (k,): these are rows of more `blocks`. Raises numpy.linalg.LinAlgError if the matrix is not positive
        definite.
        """
        L = np.zeros((len(self.row), 6, 6))
        for low in range(0, len(self._slot), COPIED):  # the blocks of a long recording take hundreds of megabytes
            some = slice(low, low + COPIED)
            part = blocks[some] if kept is None else blocks[kept[some]]
            L[self._slot[some]] = np.where(self._flipped[some, None, None], part.transpose(0, 2, 1), part)
        if not _factor(self.start, self.row, L):
            raise np.linalg.LinAlgError("the system is not positive definite")
        return L

    def solve(self, L: Floats, b: Floats) -> Floats:
        """Solution (m, 6) for the right-hand side b (m, 6)."""
        x = b[self.order]
        _solve(self.start, self.row, L, x)
        out = np.empty_like(b)
        out[self.order] = x
        return out

    def diagonal_of_inverse(self, L: Floats) -> Floats:
        """(m, 6, 6) diagonal blocks of the inverse. L is overwritten: it takes hundreds of megabytes."""
        _selected_inverse(self.start, self.row, L)
        out = np.empty((len(self.order), 6, 6))
        out[self.order] = L[self.start[:-1]]
        return out


@njit(cache=True, nogil=True, error_model="numpy")
def _factor_pattern(start: Ints, row: Ints) -> tuple[Ints, Ints]:
    """Columns of L (sorted rows, the diagonal first) from those of the lower triangle of A."""
    m = len(start) - 1
    L_start, L_row = np.zeros(m + 1, np.int64), np.empty(4 * len(row) + m, np.int64)
    first_child, sibling, mark = np.full(m, -1), np.full(m, -1), np.full(m, -1)
    for j in range(m):
        n = L_start[j]
        if n + m > len(L_row):
            L_row = np.concatenate((L_row, np.empty(len(L_row) + m, np.int64)))
        mark[j] = j
        L_row[n] = j
        n += 1
        for k in range(start[j], start[j + 1]):
            if mark[row[k]] != j:
                mark[row[k]] = j
                L_row[n] = row[k]
                n += 1
        child = first_child[j]
        while child >= 0:
            for k in range(L_start[child] + 1, L_start[child + 1]):
                if mark[L_row[k]] != j:
                    mark[L_row[k]] = j
                    L_row[n] = L_row[k]
                    n += 1
            child = sibling[child]
        L_row[L_start[j] : n].sort()
        L_start[j + 1] = n
        if n > L_start[j] + 1:
            parent = L_row[L_start[j] + 1]
            sibling[j], first_child[parent] = first_child[parent], j
    return L_start, L_row[: L_start[m]].copy()


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _subtract(B: Floats, b: int, A: Floats, a: int, C: Floats, c: int) -> None:
    """C[c] -= B[b]^T A[a], all 6 x 6; the inner loop vectorises."""
    for j in range(6):
        b0, b1, b2, b3, b4, b5 = B[b, 0, j], B[b, 1, j], B[b, 2, j], B[b, 3, j], B[b, 4, j], B[b, 5, j]
        for i in range(6):
            C[c, j, i] -= (
                b0 * A[a, 0, i]
                + b1 * A[a, 1, i]
                + b2 * A[a, 2, i]
                + b3 * A[a, 3, i]
                + b4 * A[a, 4, i]
                + b5 * A[a, 5, i]
            )


@njit(cache=True, nogil=True, error_model="numpy")
def _factor(start: Ints, row: Ints, L: Floats) -> bool:
    """The blocks of A, at the positions of L, become L; False if a pivot is not positive. All blocks are transposed."""
    m = len(start) - 1
    # Lists of the columns with rows still to be used, by their next row; `at`: position of that row.
    head, after, at = np.full(m, -1), np.full(m, -1), np.zeros(m, np.int64)
    slot = np.zeros(m, np.int64)
    for j in range(m):
        for k in range(start[j], start[j + 1]):
            slot[row[k]] = k
        d = head[j]
        while d >= 0:
            following, p = after[d], at[d]
            for k in range(p, start[d + 1]):  # L_kj -= L_kd L_jd^T
                _subtract(L, p, L, k, L, slot[row[k]])
            at[d] = p + 1
            if p + 1 < start[d + 1]:
                after[d], head[row[p + 1]] = head[row[p + 1]], d
            d = following
        D = L[start[j]]
        for a in range(6):
            for b in range(a + 1):
                x = D[b, a]
                for k in range(b):
                    x -= D[k, a] * D[k, b]
                if a > b:
                    D[b, a] = x / D[b, b]
                    D[a, b] = 0.0
                elif x > 0:
                    D[a, a] = np.sqrt(x)
                else:
                    return False
        for k in range(start[j] + 1, start[j + 1]):
            for a in range(6):
                for b in range(a):
                    x = D[b, a]
                    for i in range(6):
                        L[k, a, i] -= x * L[k, b, i]
                x = 1 / D[a, a]
                for i in range(6):
                    L[k, a, i] *= x
        if start[j + 1] > start[j] + 1:
            at[j], parent = start[j] + 1, row[start[j] + 1]
            after[j], head[parent] = head[parent], j
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(start: Ints, row: Ints, L: Floats, x: Floats) -> None:
    """x (m, 6) becomes (L L^T)^-1 x."""
    m = len(start) - 1
    for j in range(m):
        D = L[start[j]]
        for a in range(6):
            for b in range(a):
                x[j, a] -= D[b, a] * x[j, b]
            x[j, a] /= D[a, a]
        for k in range(start[j] + 1, start[j + 1]):
            for b in range(6):
                for a in range(6):
                    x[row[k], a] -= L[k, b, a] * x[j, b]
    for j in range(m - 1, -1, -1):
        D = L[start[j]]
        for k in range(start[j] + 1, start[j + 1]):
            for b in range(6):
                for a in range(6):
                    x[j, b] -= L[k, b, a] * x[row[k], a]
        for a in range(5, -1, -1):
            for b in range(a + 1, 6):
                x[j, a] -= D[a, b] * x[j, b]
            x[j, a] /= D[a, a]


@njit(cache=True, nogil=True, error_model="numpy")
def _selected_inverse(start: Ints, row: Ints, Z: Floats) -> None:
    """The blocks of L in Z become those of the inverse at the same positions, also transposed."""
    m = len(start) - 1
    slot = np.full(m, -1)
    longest = 0
    for j in range(m):
        longest = max(longest, start[j + 1] - start[j])
    W, inverse, turned = np.empty((longest, 6, 6)), np.zeros((6, 6)), np.empty((1, 6, 6))
    for j in range(m - 1, -1, -1):
        first, last = start[j], start[j + 1]
        D = Z[first]
        for a in range(6):  # inverse = L_jj^-1, lower triangular
            inverse[a, a] = 1 / D[a, a]
            for b in range(a):
                x = 0.0
                for k in range(b, a):
                    x -= D[k, a] * inverse[k, b]
                inverse[a, b] = x / D[a, a]
        for p in range(first + 1, last):  # W = L_sj L_jj^-1
            slot[row[p]] = p
            for a in range(6):
                for b in range(6):
                    x = 0.0
                    for k in range(b, 6):
                        x += Z[p, k, a] * inverse[k, b]
                    W[p - first, a, b] = x
            for a in range(6):
                for b in range(6):
                    Z[p, a, b] = 0.0
        for p in range(first + 1, last):  # block (q, k) contributes to Z_qj and, transposed, to Z_kj
            k = row[p]
            _subtract(W, p - first, Z, start[k], Z, p)
            for q in range(start[k] + 1, start[k + 1]):
                i = slot[row[q]]
                if i >= 0:
                    _subtract(W, p - first, Z, q, Z, i)
                    for a in range(6):
                        for b in range(6):
                            turned[0, a, b] = Z[q, b, a]
                    _subtract(W, i - first, turned, 0, Z, p)
        for a in range(6):
            for b in range(6):
                x = 0.0
                for k in range(max(a, b), 6):
                    x += inverse[k, a] * inverse[k, b]
                for p in range(first + 1, last):
                    for k in range(6):
                        x -= Z[p, a, k] * W[p - first, k, b]
                Z[first, a, b] = x
        for p in range(first + 1, last):
            slot[row[p]] = -1
