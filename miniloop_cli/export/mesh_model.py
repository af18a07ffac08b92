"""A triangle mesh for a file, coloured at its vertices or by a texture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, eye_array

from miniloop_cli.typing import Bools, Bytes, Floats32, Ints

Triangles = NDArray[np.int32]


@dataclass(frozen=True)
class Texture:
    """`uv` (n, 2) of each vertex, in [0, 1] from the top left corner of `image` (h, w, 3) RGB, u right and v down."""

    uv: Floats32
    image: Bytes


@dataclass(frozen=True)
class Mesh:
    """Vertices (n, 3) in metres in the world of trajectory.txt, their colours (n, 3) RGB, triangles (m, 3).

    In a textured mesh, a vertex is repeated for each of its charts.
    """

    vertices: Floats32
    colors: Bytes
    triangles: Triangles
    texture: Texture | None = None

    def subset(self, kept: Bools | Ints) -> Mesh:
        """The kept triangles, a mask (m,) or numbers (k,), and their vertices.

        Raises ValueError for a mesh with a texture.
        """
        if self.texture:
            raise ValueError("a textured mesh is not taken apart")
        used, triangles = np.unique(self.triangles[kept], return_inverse=True)
        return Mesh(self.vertices[used], self.colors[used], triangles.reshape(-1, 3).astype(np.int32))


def vertex_normals(mesh: Mesh) -> Floats32:
    """(n, 3) unit normals, means over the triangles of a vertex by area; 0 where there are none."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    total = np.stack(
        [
            np.bincount(mesh.triangles.ravel(), np.repeat(normal[:, axis], 3), minlength=len(mesh.vertices))
            for axis in range(3)
        ],
        axis=1,
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(length > 0, length, 1), np.float32)


def edges_of(triangles: Triangles) -> Ints:
    """(k, 2) vertices of every edge once, the smaller first."""
    ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.int64)
    keys = np.unique(ends[:, 0] << 32 | ends[:, 1])
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1)


def face_pairs(triangles: Triangles) -> Ints:
    """(k, 2) triangles that share an edge; of more than two at an edge, neighbours in order."""
    ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.int64)
    keys = ends[:, 0] << 32 | ends[:, 1]
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(np.diff(keys[order]) == 0)
    return np.stack([order[same], order[same + 1]], axis=1) // 3


def averaging(mesh: Mesh) -> csr_array:
    """(n, n) float32 matrix that replaces the value of each vertex by the mean of it and its neighbours."""
    edges, n = edges_of(mesh.triangles), len(mesh.vertices)
    ones = np.ones(len(edges), np.float32)
    joined = coo_array((ones, (edges[:, 0], edges[:, 1])), shape=(n, n)).tocsr()
    joined = joined + joined.T + eye_array(n, dtype=np.float32, format="csr")
    weight = (1 / np.asarray(joined.sum(axis=1)).ravel()).astype(np.float32)
    joined.data *= np.repeat(weight, np.diff(joined.indptr))
    return csr_array(joined)
