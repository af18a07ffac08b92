"""Symmetric positive definite systems of 6 x 6 blocks, one block row a pose: solutions and marginal covariances."""

from __future__ import annotations

from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.refinement.block_cholesky import BlockPattern
from miniloop_cli.typing import Bools, Floats, Ints

Method = Literal["dense", "sparse", "gradients"]

SMALL = 128  # poses: a dense factorisation takes milliseconds
DENSE_UP_TO = 300  # poses; beyond, conjugate gradients are faster where most poses see each other
FULL_SHARE = 0.5  # of the blocks: with more of them, the factor is dense
SPARSE_WORK = 0.15  # of the products of a dense factorisation, which BLAS computes six times faster each
TOLERANCE, MOST_STEPS = 1e-6, 300  # of conjugate gradients: the residual as a share of the right-hand side


class BlockIndex(NamedTuple):
    """The blocks right of the diagonal in row i have the numbers start[i] to start[i + 1] - 1, columns ascending.

    start (n + 1,); columns (blocks,) of every block. Block i, of the first n, is the diagonal one of row i. Blocks of
    poses that are not free (n,) are not used.
    """

    start: Ints
    columns: NDArray[np.uint32]
    free: Bools


class BlockSystem:
    """The pattern of the upper triangle: block k stands at (rows[k], cols[k]), rows <= cols; the first n are diagonal.

    `held` (n,) bool poses are taken out of the system: their solution is zero, and so is their covariance.
    `method`: a dense or a sparse Cholesky factorisation, or conjugate gradients; by default the fastest for the
    pattern. Where gradients do not converge, and for covariances, the dense factor is used instead.
    Methods that factorise raise numpy.linalg.LinAlgError if the blocks are not positive definite.
    """

    def __init__(self, held: Bools, pairs: Ints, method: Method | None = None) -> None:
        n = len(held)
        low, high = np.sort(pairs.reshape(-1, 2), axis=1).T
        self._off = np.unique(low[low < high] * n + high[low < high])
        self.n, self.free = n, np.flatnonzero(~held)
        self.rows = np.concatenate([np.arange(n), self._off // n])
        self.cols = np.concatenate([np.arange(n), self._off % n])
        place = np.cumsum(~held) - 1
        self._kept = np.flatnonzero(~held[self.rows] & ~held[self.cols])
        self._r, self._c = place[self.rows[self._kept]], place[self.cols[self._kept]]
        self.method = method or self._fastest_method()

    def _fastest_method(self) -> Method:
        """Chosen by the work of a sparse factorisation, which its fill-in determines."""
        m = len(self.free)
        if m <= SMALL:
            return "dense"
        if len(self._kept) < FULL_SHARE * m * m / 2 and self._sparse.products < SPARSE_WORK * (6 * m) ** 3 / 3:
            return "sparse"
        return "dense" if m <= DENSE_UP_TO else "gradients"

    def __len__(self) -> int:
        return len(self.rows)

    def block_of(self, i: Ints, j: Ints) -> Ints:
        """Numbers (m,) of the blocks of the pairs (i, j), i != j, (m,) each, in either order."""
        return self.n + np.searchsorted(self._off, np.minimum(i, j) * self.n + np.maximum(i, j))

    def index(self) -> BlockIndex:
        """The numbers of the blocks, for kernels."""
        start = self.n + np.searchsorted(self._off, np.arange(self.n + 1) * self.n)
        return BlockIndex(start, self.cols.astype(np.uint32), np.isin(np.arange(self.n), self.free))

    def solve(self, blocks: Floats, right: Floats) -> Floats:
        """Solution (n, 6) of the system of (len, 6, 6) blocks for the right-hand side (n, 6)."""
        from scipy.linalg import cho_solve

        x = np.zeros_like(right)
        b = right[self.free]
        if not len(b):
            return x
        if self.method == "sparse":
            x[self.free] = self._sparse.solve(self._sparse.factor(blocks, self._kept), b)
            return x
        found = self._by_gradients(blocks[self._kept], b) if self.method == "gradients" else None
        if found is None:
            found = cho_solve((self._dense(blocks), True), b.ravel(), check_finite=False).reshape(-1, 6)
        x[self.free] = found
        return x

    def solve_columns(self, blocks: Floats, right: Floats) -> Floats:
        """Solutions (n, 6, c) for many right-hand sides (n, 6, c) at once, by one factorisation."""
        from scipy.linalg import cho_solve

        x, b = np.zeros_like(right), right[self.free]
        if not len(b):
            return x
        if self.method == "sparse":
            L = self._sparse.factor(blocks[self._kept])
            columns = [self._sparse.solve(L, np.ascontiguousarray(b[:, :, k])) for k in range(b.shape[2])]
            x[self.free] = np.stack(columns, axis=2)
        else:
            flat = b.reshape(-1, b.shape[2])
            x[self.free] = cho_solve((self._dense(blocks), True), flat, check_finite=False).reshape(b.shape)
        return x

    def marginals(self, blocks: Floats) -> Floats:
        """(n, 6, 6) diagonal blocks of the inverse of the system of (len, 6, 6) blocks."""
        from scipy.linalg.lapack import dpotri

        Z = np.zeros((self.n, 6, 6))
        if not len(self.free):
            return Z
        if self.method == "sparse":
            Z[self.free] = self._sparse.diagonal_of_inverse(self._sparse.factor(blocks, self._kept))
            return Z
        inverse = dpotri(self._dense(blocks), lower=1, overwrite_c=1)[0]
        k = 6 * np.arange(len(self.free))[:, None] + np.arange(6)
        Z[self.free] = inverse[k[:, :, None], k[:, None, :]]
        return np.tril(Z) + np.tril(Z, -1).transpose(0, 2, 1)

    def _by_gradients(self, blocks: Floats, right: Floats) -> Floats | None:
        """Solution (m, 6) by conjugate gradients on the kept blocks; None if they do not converge.

        If many poses all see each other, a few dozen steps suffice. Their cost grows with the number of blocks, not
        with the cube of the poses. The preconditioner is the inverse of the diagonal blocks.
        """
        from scipy.sparse import bsr_array
        from scipy.sparse.linalg import LinearOperator, cg

        upper, lower, column, start = self._whole
        values = np.empty((len(column), 6, 6))
        values[lower] = blocks.transpose(0, 2, 1)
        values[upper] = blocks  # for a diagonal block both positions are the same
        A = bsr_array((values, column, start), shape=(right.size, right.size))
        inverse = np.linalg.inv(blocks[: len(right)])  # the diagonal ones come first
        M = LinearOperator(A.shape, lambda v: np.einsum("nij,nj->ni", inverse, v.reshape(-1, 6)).ravel())
        x, unsettled = cg(A, right.ravel(), rtol=TOLERANCE, maxiter=MOST_STEPS, M=M)
        return None if unsettled or x @ right.ravel() < 0 else x.reshape(-1, 6)

    @cached_property
    def _whole(self) -> tuple[Ints, Ints, Ints, Ints]:
        """The kept blocks and their mirror images in the rows of the whole matrix: positions, columns, starts."""
        off = np.flatnonzero(self._r != self._c)
        row, column = np.concatenate([self._r, self._c[off]]), np.concatenate([self._c, self._r[off]])
        order = np.lexsort((column, row))
        place = np.argsort(order)
        upper = place[: len(self._r)]
        lower = upper.copy()
        lower[off] = place[len(self._r) :]
        return upper, lower, column[order], np.searchsorted(row[order], np.arange(len(self.free) + 1))

    @cached_property
    def _sparse(self) -> BlockPattern:
        return BlockPattern(len(self.free), self._r, self._c)

    def _dense(self, blocks: Floats) -> Floats:
        """Lower Cholesky factor (6m, 6m) of the kept blocks, in LAPACK's order."""
        from scipy.linalg import cholesky

        m = len(self.free)
        M = np.zeros((m, 6, m, 6))
        M[self._r, :, self._c, :] = blocks[self._kept]  # the lower triangle is never read
        # LAPACK takes the transpose of an array in C order without a copy.
        return cholesky(M.reshape(6 * m, 6 * m).T, lower=True, overwrite_a=True, check_finite=False)
