"""Levelled seams between views: an offset of the colours that is smooth within a patch and closes the steps.

Global seam levelling (Lempitsky & Ivanov 2007, Seamless Mosaicing of Image-Based Texture Maps, equation 3).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array

from miniloop_cli.export.mesh_model import Triangles, edges_of
from miniloop_cli.typing import Floats, Floats32, Ints

SEAM_WEIGHT = 10.0  # of a remaining step, against a difference of the offsets of two neighbours
REST_WEIGHT = 4e-3  # of the offset itself: it decays over some 15 triangles
PRECISION = 1e-2
MOST_STEPS = 500


def seam_pairs(vertex: Ints) -> Ints:
    """(k, 2) nodes of one vertex, next to each other in order; `vertex` (n,) is that of each node."""
    order = np.argsort(vertex, kind="stable")
    same = np.flatnonzero(np.diff(vertex[order]) == 0)
    return np.stack([order[same], order[same + 1]], axis=1)


def level(corners: Triangles, pairs: Ints, colors: Floats32) -> Floats32:
    """(n, 3) offsets of the colours of n nodes. A node is a vertex in a patch, `corners` (m, 3) are triangles.

    `pairs` (k, 2): nodes that are one vertex in two patches; `colors` (n, 3) are read for these only.
    """
    n = len(colors)
    if not len(pairs):
        return np.zeros((n, 3), np.float32)
    edges = edges_of(corners)
    ends = np.concatenate([edges, pairs])
    weight = np.concatenate([np.ones(len(edges)), np.full(len(pairs), SEAM_WEIGHT)])
    joined = coo_array((weight, (ends[:, 0], ends[:, 1])), shape=(n, n)).tocsr()
    joined = joined + joined.T
    diagonal = np.asarray(joined.sum(axis=1)).ravel() + REST_WEIGHT
    A = diags_array(diagonal, format="csr") - joined
    step = SEAM_WEIGHT * (colors[pairs[:, 0]].astype(float) - colors[pairs[:, 1]])
    push = [np.bincount(pairs[:, 1], step[:, c], n) - np.bincount(pairs[:, 0], step[:, c], n) for c in range(3)]
    return solve(A, diagonal, np.stack(push, axis=1)).astype(np.float32)


def solve(A: csr_array, diagonal: Floats, b: Floats) -> Floats:
    """A^-1 b for several right sides (n, c) at once, by conjugate gradients with the diagonal as preconditioner."""
    x, r = np.zeros_like(b), b.copy()
    z = r / diagonal[:, None]
    d, rz = z.copy(), (r * z).sum(axis=0)
    enough = PRECISION**2 * rz
    for _ in range(MOST_STEPS):
        if (rz <= enough).all():
            break
        Ad = A @ d
        along = rz / np.maximum((d * Ad).sum(axis=0), 1e-300)
        x += along * d
        r -= along * Ad
        z = r / diagonal[:, None]
        rz, before = (r * z).sum(axis=0), rz
        d = z + rz / np.maximum(before, 1e-300) * d
    return x
