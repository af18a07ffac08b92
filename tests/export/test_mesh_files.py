"""GLB, OBJ and PLY as other programs read them: shape, colours, texture, and which way is up."""

import json
import struct

import numpy as np
import pytest

from miniloop_cli.export.mesh_file import write_mesh
from miniloop_cli.export.mesh_model import Mesh, Texture
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.upward import to_y_up

trimesh = pytest.importorskip("trimesh")
PAINT = [[230, 20, 20], [20, 230, 20], [20, 20, 230], [230, 230, 20]]


@pytest.fixture
def house():
    """A square of two triangles and a roof: no symmetry hides an axis or an order that is wrong."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0], [0.5, 1, 3]], np.float32)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 1]], np.int32)
    colors = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [10, 120, 200], [200, 100, 50]], np.uint8)
    return Mesh(vertices, colors, triangles)


@pytest.fixture
def painted(house):
    """The same with a texture of four quarters; each vertex lies in the middle of one of them."""
    image = np.zeros((64, 128, 3), np.uint8)
    for k, color in enumerate(PAINT):
        image[32 * (k // 2) :, 64 * (k % 2) :] = color
    uv = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75], [0.25, 0.25]], np.float32)
    return Mesh(house.vertices, house.colors, house.triangles, Texture(uv, image))


def by_trimesh(path):
    """Vertices (world of the scene) and triangles; the visual."""
    mesh = trimesh.load(path, process=False, maintain_order=True, force="mesh")
    return np.asarray(mesh.vertices), np.asarray(mesh.faces), mesh.visual


def corners(vertices, triangles):
    """(m, 9) corner points of the triangles, sorted: whatever the order of vertices."""
    return np.sort(vertices[triangles].reshape(-1, 9).round(5), axis=0)


def painted_colors(visual, count):
    """Colours of the texture at the vertices."""
    image = np.asarray((getattr(visual.material, "image", None) or visual.material.baseColorTexture).convert("RGB"))
    assert image.shape == (64, 128, 3) and len(visual.uv) == count
    h, w = image.shape[:2]
    u, v = visual.uv.T
    return image[((1 - v) * h).astype(int), (u * w).astype(int)]


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply"])
def test_shape_and_colors_of_vertices(house, tmp_path, suffix):
    (path,) = write_mesh(tmp_path / f"house{suffix}", house, np.eye(4))
    vertices, triangles, visual = by_trimesh(path)
    np.testing.assert_allclose(corners(vertices, triangles), corners(house.vertices, house.triangles), atol=1e-5)
    if suffix != ".glb":
        colors = np.asarray(visual.vertex_colors)[:, :3] / 255
    else:  # linear in light, by the specification
        (geometry,) = trimesh.load_scene(path, process=False).geometry.values()
        vertices, colors = geometry.vertices, geometry.visual.vertex_attributes["color"][:, :3] / 65535
        colors = np.where(colors <= 0.0031308, 12.92 * colors, 1.055 * colors ** (1 / 2.4) - 0.055)
    order = [int(np.linalg.norm(vertices - v, axis=1).argmin()) for v in house.vertices]
    np.testing.assert_allclose(255 * colors[order], house.colors, atol=1)


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply"])
def test_texture_is_where_it_belongs(painted, tmp_path, suffix):
    path, *others = write_mesh(tmp_path / f"a house{suffix}", painted, np.eye(4))
    assert [other.suffix for other in others] == {".glb": [], ".obj": [".mtl", ".jpg"], ".ply": [".jpg"]}[suffix]
    vertices, triangles, visual = by_trimesh(path)
    np.testing.assert_allclose(corners(vertices, triangles), corners(painted.vertices, painted.triangles), atol=1e-5)
    colors = painted_colors(visual, len(vertices)).astype(int)
    expected = np.array([*PAINT, PAINT[0]])
    order = [int(np.linalg.norm(vertices - v, axis=1).argmin()) for v in painted.vertices]
    assert np.abs(colors[order] - expected).max() < 12  # JPEG


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply"])
def test_open3d_reads_them_too(painted, tmp_path, suffix):
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    path = write_mesh(tmp_path / f"house{suffix}", painted, np.eye(4))[0]
    mesh = o3d.io.read_triangle_mesh(str(path))
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    np.testing.assert_allclose(corners(vertices, triangles), corners(painted.vertices, painted.triangles), atol=1e-5)
    if suffix == ".ply":  # of PLY, Open3D reads no texture
        return
    # It has an empty texture for triangles without a material, whether there are any or not.
    (image,) = (np.asarray(texture)[..., :3] for texture in mesh.textures if not texture.is_empty())
    uv = np.asarray(mesh.triangle_uvs)
    assert image.shape == (64, 128, 3)
    at = vertices[triangles].reshape(-1, 3)
    expected = np.array([*PAINT, PAINT[0]])[[int(np.linalg.norm(painted.vertices - p, axis=1).argmin()) for p in at]]
    # Its images of OBJ are turned over, as textures of that format begin at the bottom.
    found = image[(uv[:, 1] * 64).astype(int), (uv[:, 0] * 128).astype(int)].astype(int)
    assert np.abs(found - expected).max() < 12


def test_glb_follows_the_specification(painted, tmp_path):
    (path,) = write_mesh(tmp_path / "house.glb", painted, np.eye(4))
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and size % 4 == 0
    text = json.loads(data[20 : 20 + size])
    binary, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert kind == b"BIN\0" and text["buffers"] == [{"byteLength": binary}] and binary % 4 == 0
    for view in text["bufferViews"]:
        assert view["byteOffset"] % 4 == 0 and view["byteOffset"] + view["byteLength"] <= binary
    position = text["accessors"][text["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    assert position["min"] == [0, 0, 0] and position["max"] == [1, 2, 3]


@pytest.mark.parametrize("leveled", [True, False])
def test_up_is_y_in_a_glb(house, tmp_path, leveled):
    """The roof is on top: of a world with z up, and of one that only upright cameras tell of."""
    w = np.array([[0, a, 0] for a in (-0.3, 0.0, 0.4)])
    T = se3.pose(se3.exp_so3(w), np.zeros((3, 3)))
    mesh = house
    if leveled:
        T = se3.pose(np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]) @ T[:, :3, :3], np.zeros((3, 3)))
    else:
        mesh = Mesh(house.vertices[:, [0, 2, 1]] * np.float32([1, -1, 1]), house.colors, house.triangles)  # y down
    turn = to_y_up(T, leveled)
    assert np.linalg.det(turn[:3, :3]) == pytest.approx(1)
    (path,) = write_mesh(tmp_path / "house.glb", mesh, turn)
    vertices = by_trimesh(path)[0]
    assert vertices[:, 1].max() == pytest.approx(3, abs=1e-5) and vertices[:, 1].min() == pytest.approx(0, abs=1e-5)
    assert np.ptp(vertices[:, 0]) < 2.01
