"""Small pieces go, large ones and small models stay; a closed surface is closed."""

import numpy as np
import pytest

from miniloop_cli.export.floaters import diagonals, pieces, without_floaters
from miniloop_cli.export.mesh_model import Mesh, averaging, edges_of, face_pairs, vertex_normals
from miniloop_cli.export.watertight import is_closed, watertight


def sheet(side_m, count=12, shift=(0, 0, 0)):
    """A square sheet in z = 0, facing up."""
    axis = np.linspace(0, side_m, count, dtype=np.float32)
    x, y = np.meshgrid(axis, axis)
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1) + np.float32(shift)
    k = np.arange(count * count).reshape(count, count)
    a, b, c, d = (part.ravel() for part in (k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)]).astype(np.int32)
    return Mesh(vertices.astype(np.float32), np.full((len(vertices), 3), 128, np.uint8), triangles)


def together(*meshes):
    first = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    triangles = np.concatenate([mesh.triangles + k for mesh, k in zip(meshes, first[:-1], strict=True)])
    parts = [np.concatenate([getattr(mesh, name) for mesh in meshes]) for name in ("vertices", "colors")]
    return Mesh(*parts, triangles.astype(np.int32))


def test_small_pieces_are_left_out():
    both = together(sheet(2.0), sheet(0.05, 4, (0, 0, 1)), sheet(0.5, 4, (5, 0, 0)))
    assert np.sort(diagonals(both, pieces(both))) == pytest.approx(np.sqrt(2) * np.array([0.05, 0.5, 2.0]))
    kept, left = without_floaters(both, 0.2)
    assert left == 1 and len(kept.triangles) == 2 * (11**2 + 3**2)
    assert kept.vertices[:, 2].max() == 0
    assert without_floaters(both, 0)[1] == 0


def test_a_small_model_is_no_floater():
    small = together(sheet(0.08), sheet(0.03, 4, (0, 0, 0.05)))
    kept, left = without_floaters(small, 0.2)
    assert left == 0 and len(kept.triangles) == len(small.triangles)


def test_neighbours_of_a_sheet():
    mesh = sheet(1.0, 3)
    assert len(edges_of(mesh.triangles)) == 16 and len(face_pairs(mesh.triangles)) == 8
    np.testing.assert_allclose(vertex_normals(mesh), np.tile([0, 0, 1], (9, 1)), atol=1e-6)
    np.testing.assert_allclose(averaging(mesh) @ np.ones(9, np.float32), 1, rtol=1e-6)


def test_a_dome_is_closed_on_request():
    """What is open below gets a floor; above, it stays a sphere."""
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    ball = o3d.geometry.TriangleMesh.create_sphere(0.5, resolution=24)
    vertices, triangles = np.asarray(ball.vertices, np.float32), np.asarray(ball.triangles, np.int32)
    whole = Mesh(vertices, np.full((len(vertices), 3), 90, np.uint8), triangles)
    dome = whole.subset(vertices[triangles][:, :, 2].min(axis=1) > -0.2)
    assert is_closed(whole) and not is_closed(dome)
    closed = watertight(o3d, dome, 0.04)
    assert is_closed(closed)
    above = closed.vertices[closed.vertices[:, 2] > 0.1]
    assert np.abs(np.linalg.norm(above, axis=1) - 0.5).max() < 0.03
    assert np.abs(closed.colors.astype(int) - 90).max() <= 2
