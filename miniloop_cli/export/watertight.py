"""A closed surface through an open one, for printing and simulation: screened Poisson (Kazhdan & Hoppe 2013)."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from miniloop_cli.errors import MiniloopError
from miniloop_cli.export.floaters import diagonals, pieces
from miniloop_cli.export.mesh_model import Mesh, vertex_normals
from miniloop_cli.typing import Bytes

LEAST_DEPTH, MOST_DEPTH = 5, 10  # of the octree
ROOM = 2.0  # the octree's cube over the extent of the points, as the surface would end at its walls


def watertight(o3d: ModuleType, mesh: Mesh, voxel_m: float) -> Mesh:
    """One closed surface along the mesh; holes are filled with invented surface. Its cells have about voxel size.

    Raises MiniloopError if the result is not closed.
    """
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    depth = int(np.clip(np.ceil(np.log2(ROOM * extent / voxel_m)), LEAST_DEPTH, MOST_DEPTH))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(mesh.vertices.astype(float)))
    cloud.normals = o3d.utility.Vector3dVector(vertex_normals(mesh).astype(float))
    cloud.colors = o3d.utility.Vector3dVector(mesh.colors / 255.0)
    # One thread: with more, the result differs from run to run.
    made, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth, scale=ROOM, n_threads=1)
    colors: Bytes = np.rint(255 * np.clip(np.asarray(made.vertex_colors), 0, 1)).astype(np.uint8)
    triangles = np.asarray(made.triangles, np.int32)
    closed = Mesh(np.asarray(made.vertices, np.float32), colors, triangles)
    piece = pieces(closed)
    closed = closed.subset(piece[triangles[:, 0]] == diagonals(closed, piece).argmax())
    if not is_closed(closed):
        raise MiniloopError("these scans give no closed surface: too much of it was not seen; try --voxel 0.02")
    return closed


def is_closed(mesh: Mesh) -> bool:
    """Whether every edge has one triangle on each side, with the same orientation."""
    ends = mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    there, back = np.sort(ends[:, 0] << 32 | ends[:, 1]), np.sort(ends[:, 1] << 32 | ends[:, 0])
    return len(there) > 0 and bool((np.diff(there) > 0).all()) and np.array_equal(there, back)
