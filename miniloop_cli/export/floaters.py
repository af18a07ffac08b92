"""Separate pieces of a surface: small ones are noise of the depth, not objects."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from miniloop_cli.export.mesh_model import Mesh, edges_of
from miniloop_cli.typing import Floats, Ints

MOST_OF_WHOLE = 0.1  # a piece with this share of the whole is kept, for any size


def without_floaters(mesh: Mesh, min_piece_m: float) -> tuple[Mesh, int]:
    """The mesh without pieces whose bounding box has a diagonal shorter than `min_piece_m`, and their number.

    In a small model, pieces of a tenth of it are kept.
    """
    if min_piece_m <= 0 or not len(mesh.triangles):
        return mesh, 0
    piece = pieces(mesh)
    diagonal = diagonals(mesh, piece)
    small = diagonal < min(min_piece_m, MOST_OF_WHOLE * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))))
    small[diagonal.argmax()] = False
    return mesh.subset(~small[piece[mesh.triangles[:, 0]]]), int(small.sum())


def pieces(mesh: Mesh) -> Ints:
    """(n,) number of the connected piece of each vertex."""
    edges, n = edges_of(mesh.triangles), len(mesh.vertices)
    joined = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    return np.asarray(connected_components(joined, directed=False)[1], np.int64)


def diagonals(mesh: Mesh, piece: Ints) -> Floats:
    """Lengths (m) of the diagonals of the pieces' bounding boxes.

    piece (n,) of each vertex.
    """
    order = np.argsort(piece, kind="stable")
    start = np.flatnonzero(np.diff(piece[order], prepend=-1))
    points = mesh.vertices[order].astype(float)
    return np.linalg.norm(np.maximum.reduceat(points, start) - np.minimum.reduceat(points, start), axis=1)
