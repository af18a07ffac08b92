"""Symmetric positive definite systems of 6 x 6 blocks, one block row a pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_DENSE_UP_TO = 300  # poses; beyond, a sparse factorisation is faster unless all poses see each other


class BlockSystem:
    """The pattern of the upper triangle: block k stands at (rows[k], cols[k]), rows <= cols; the first n are diagonal.

    `fixed` (n,) bool poses are taken out of the system: their solution is zero, and so is their covariance.
    """

    def __init__(self, fixed: NDArray[np.bool_], pairs: NDArray[np.int64]) -> None:
        n = len(fixed)
        low, high = np.sort(pairs.reshape(-1, 2), axis=1).T
        off = np.unique(low[low < high] * n + high[low < high])
        diagonal = np.arange(n)
        self.n, self.free = n, np.flatnonzero(~fixed)
        self.rows = np.concatenate([diagonal, off // n])
        self.cols = np.concatenate([diagonal, off % n])
        self._off = off
        position = np.cumsum(~fixed) - 1
        self._kept = np.flatnonzero(~fixed[self.rows] & ~fixed[self.cols])
        self._r, self._c = position[self.rows[self._kept]], position[self.cols[self._kept]]

    def __len__(self) -> int:
        return len(self.rows)

    def block_of(self, i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.int64]:
        """Numbers of the blocks that hold the pairs (i, j), i != j, in either order."""
        return self.n + np.searchsorted(self._off, np.minimum(i, j) * self.n + np.maximum(i, j))

    def table(self) -> NDArray[np.uint32]:
        """(n, n) block numbers of the upper triangle, for kernels that look up millions; 4 n^2 bytes."""
        table = np.zeros((self.n, self.n), np.uint32)
        table[self.rows, self.cols] = np.arange(len(self))
        return table

    def factor(self, blocks: Array) -> Factor:
        """Factorise (len, 6, 6) blocks. Raises numpy.linalg.LinAlgError if they are not positive definite."""
        m = len(self.free)
        dense = m <= _DENSE_UP_TO or len(self._kept) > 0.15 * m * m
        assemble = _dense if dense else _sparse
        return Factor(self, assemble(m, self._r, self._c, blocks[self._kept]))


class Factor:
    """A factorised system."""

    def __init__(self, system: BlockSystem, matrix: object) -> None:
        from scipy.linalg import cho_factor
        from scipy.sparse.linalg import splu

        self._system = system
        if isinstance(matrix, np.ndarray):
            self._cholesky = cho_factor(matrix, overwrite_a=True, check_finite=False) if matrix.size else None
            self._lu = None
        else:
            options = {"SymmetricMode": True}
            self._lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
            if not np.all(self._lu.U.diagonal() > 0):
                raise np.linalg.LinAlgError("the sparse system is not positive definite")

    def solve(self, right: Array) -> Array:
        """(n, 6) or (n, 6, c) right-hand sides to solutions of that shape; rows of fixed poses are zero."""
        from scipy.linalg import cho_solve

        free = self._system.free
        b = right[free].reshape(6 * len(free), -1)
        out = np.zeros_like(right)
        if len(free):
            x = self._lu.solve(b) if self._lu is not None else cho_solve(self._cholesky, b, check_finite=False)
            out[free] = x.reshape(len(free), *right.shape[1:])
        return out


def _dense(m: int, r: NDArray[np.int64], c: NDArray[np.int64], blocks: Array) -> Array:
    M = np.zeros((m, 6, m, 6))
    M[r, :, c, :] = blocks  # only the upper triangle is read
    return M.reshape(6 * m, 6 * m)


def _sparse(m: int, r: NDArray[np.int64], c: NDArray[np.int64], blocks: Array) -> object:
    from scipy.sparse import bsr_array

    off = r != c
    rows, cols = np.concatenate([r, c[off]]), np.concatenate([c, r[off]])
    data = np.concatenate([blocks, blocks[off].transpose(0, 2, 1)])
    order = np.lexsort((cols, rows))
    start = np.searchsorted(rows[order], np.arange(m + 1))
    return bsr_array((data[order], cols[order], start), shape=(6 * m, 6 * m)).tocsc()
