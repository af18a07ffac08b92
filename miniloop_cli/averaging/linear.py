"""Weighted least squares over differences on a graph: the one linear problem of motion averaging.

Rotations (in the tangent space) and translations both ask for vectors x with x_i - x_j = d_ij on every edge (i, j).
The normal equations are L x = A' W d with the graph's Laplacian L = A' W A, the same for every coordinate.
The gauge: x of the first scan is zero.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging.graph import Floats, Ints

DENSE_SCANS = 600
"""Up to here a dense Cholesky factorisation is fastest."""


def solve_differences(count: int, pairs: Ints, weights: Floats, d: Floats) -> Floats:
    """x (count, k) with x[0] = 0 that minimises sum of w_e |x_i - x_j - d_e|^2 over the edges of a connected graph.

    `pairs` (m, 2), `weights` (m,) positive where an edge counts, `d` (m, k).
    """
    i, j = pairs.T
    x = np.zeros((count, d.shape[1]))
    if count < 2:
        return x
    wd = weights[:, None] * d
    b = np.stack([np.bincount(i, c, count) - np.bincount(j, c, count) for c in wd.T], axis=1)[1:]
    degree = np.bincount(i, weights, count) + np.bincount(j, weights, count)
    if count <= DENSE_SCANS:
        from scipy.linalg import cho_factor, cho_solve

        L = -np.bincount(i * count + j, weights, count * count).reshape(count, count)
        L += L.T
        L[np.diag_indices(count)] = degree
        x[1:] = cho_solve(cho_factor(L[1:, 1:], overwrite_a=True, check_finite=False), b, check_finite=False)
        return x
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import splu

    upper = coo_array((weights, (i, j)), shape=(count, count)).tocsc()
    L = (diags_array(degree) - upper - upper.T).tocsc()[1:, 1:]
    factor = splu(L, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    x[1:] = factor.solve(b)
    return x
