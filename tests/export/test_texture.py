"""The texture of known scenes: it sits where the images say, levels what exposure did, and sees through nothing."""

import importlib
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.cli.mesh import mesh as mesh_command
from miniloop_cli.datasets import open_sequence, read_ground_truth, read_scan
from miniloop_cli.datasets.intrinsics import save_camera
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.export.make_mesh import Wishes, make_mesh
from miniloop_cli.export.mesh_model import face_pairs
from miniloop_cli.export.model import Model
from miniloop_cli.export.texture.exposure import gains
from miniloop_cli.export.texture.glimpses import sharpness
from miniloop_cli.export.texture.labels import choose_labels, patches
from miniloop_cli.export.texture.pack import pack
from miniloop_cli.export.texture.seams import level, seam_pairs
from miniloop_cli.export.undistort import undistorter
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.results.folder import Results
from miniloop_cli.scene.interpolation import interpolate
from miniloop_cli.scene.sequence import Trajectory
from tests.export.test_floaters import sheet

REAL = os.environ.get("MINILOOP_TUM")
CAMERA = Camera(200, 200, 119.5, 89.5, 240, 180)
GAINS = [1.0, 0.8, 1.15, 0.9, 1.05, 0.85]
BLURRED = 2


def wall_color(x, y):
    """A pattern with fine detail of every colour and no period."""
    r = 130 + 60 * np.sin(9 * x + 3 * np.sin(5 * y)) + 30 * np.sign(np.sin(37 * x) * np.sin(31 * y))
    g = 130 + 70 * np.sin(7 * y - 4 * x * y) + 20 * np.sign(np.sin(23 * x + 11 * y))
    b = 120 + 50 * np.cos(5 * x * x + 6 * y)
    return np.stack([r, g, b], axis=-1)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Six views of a patterned wall at z = 2 with a red board 0.4 m before it; exposures differ, one is blurred."""
    folder = tmp_path_factory.mktemp("room")
    sequence, results = folder / "room", folder / "results"
    for kind in ("rgb", "depth"):
        (sequence / kind).mkdir(parents=True)
    save_camera(sequence / "camera.yaml", CAMERA)
    shifts = np.linspace(-0.5, 0.5, len(GAINS))
    T = se3.pose(
        se3.exp_so3(np.array([[0, -0.2 * s, 0] for s in shifts])), np.stack([shifts, 0 * shifts, 0 * shifts], 1)
    )
    px = np.stack(np.meshgrid(np.arange(240.0), np.arange(180.0)), axis=-1).reshape(-1, 2)
    rays = CAMERA.backproject(px, np.ones(len(px)))
    for k, pose in enumerate(T):
        direction = rays @ pose[:3, :3].T
        wall_z = (2 - pose[2, 3]) / direction[:, 2]
        board_z = (1.6 - pose[2, 3]) / direction[:, 2]
        at = pose[:3, 3] + board_z[:, None] * direction
        on_board = (np.abs(at[:, 0]) < 0.2) & (np.abs(at[:, 1]) < 0.2)
        p = pose[:3, 3] + wall_z[:, None] * direction
        color = np.where(on_board[:, None], [220, 30, 30], wall_color(p[:, 0], p[:, 1]))
        color = (GAINS[k] * color).clip(0, 255).astype(np.uint8).reshape(180, 240, 3)
        if k == BLURRED:
            color = cv2.blur(color, (13, 1))
        z = np.where(on_board, board_z, wall_z).reshape(180, 240)
        cv2.imwrite(str(sequence / "rgb" / f"{k}.0.png"), color[..., ::-1])
        cv2.imwrite(str(sequence / "depth" / f"{k}.0.png"), np.rint(5000 * z).astype(np.uint16))
    results.mkdir()
    write_trajectory(results / "trajectory.txt", Trajectory(np.arange(6.0), T))
    return results, sequence, T


@pytest.fixture(scope="module")
def made(room):
    pytest.importorskip("open3d", exc_type=ImportError)
    results, sequence, _ = room
    return make_mesh(Model(Results(results), open_sequence(sequence)), Wishes(0.02, texture=True), quiet=True)


def rendered(mesh, T_world_cam, camera=CAMERA):
    """(h, w, 3) the textured mesh as a camera sees it, by Open3D's rays; and (h, w) where it is hit."""
    o3d = importlib.import_module("open3d")
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(mesh.vertices), o3d.core.Tensor(mesh.triangles.astype(np.uint32)))
    T_cam_world = o3d.core.Tensor(se3.inverse(T_world_cam))
    # Its pixels have their centres at halves.
    K = o3d.core.Tensor(camera.K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]))
    rays = scene.create_rays_pinhole(K, T_cam_world, camera.width, camera.height)
    found = scene.cast_rays(rays)
    hit = np.isfinite(found["t_hit"].numpy())
    corners = mesh.triangles[np.where(hit, found["primitive_ids"].numpy(), 0).astype(int)]
    u, v = np.moveaxis(found["primitive_uvs"].numpy(), 2, 0)
    weight = np.stack([1 - u - v, u, v], axis=-1)
    height, width = mesh.texture.image.shape[:2]
    at = (mesh.texture.uv[corners] * weight[..., None]).sum(axis=2) * [width, height] - 0.5
    return cv2.remap(mesh.texture.image, at.astype(np.float32), None, cv2.INTER_LINEAR), hit


def errors(mesh, T, k):
    """Absolute differences of a rendered view from the true colours, without the rim of the board."""
    picture, hit = rendered(mesh, T[k])
    px = np.stack(np.meshgrid(np.arange(240.0), np.arange(180.0)), axis=-1).reshape(-1, 2)
    direction = CAMERA.backproject(px, np.ones(len(px))) @ T[k][:3, :3].T
    at, p = (T[k][:3, 3] + (z - T[k][2, 3]) / direction[:, 2:] * direction for z in (1.6, 2.0))
    reach = np.abs(at[:, :2]).max(axis=1)
    true = np.where(reach[:, None] < 0.2, [220, 30, 30], wall_color(p[:, 0], p[:, 1])).clip(0, 255)
    clear = hit.ravel() & (np.abs(reach - 0.2) > 0.04)
    return picture.reshape(-1, 3)[clear].astype(float), true[clear], clear.mean()


def test_the_texture_sits_where_the_images_show_it(room, made):
    """Seen from each camera it is the true pattern, up to one exposure for all and an eighth of its contrast."""
    for k in (0, 1, 3, 4, 5):
        picture, true, share = errors(made.mesh, room[2], k)
        assert share > 0.7
        gain = np.median(picture / true, axis=0)
        assert np.abs(picture - gain * true).mean() < 6
        assert np.corrcoef(picture[:, 1], true[:, 1])[0, 1] > 0.97


def test_a_texture_shifted_by_two_pixels_would_be_noticed(room, made):
    picture, hit = rendered(made.mesh, room[2][3])
    shown = cv2.imread(str(room[1] / "rgb" / "3.0.png"))[..., ::-1].astype(float)

    def difference(image):
        inner = hit[10:-10, 10:-10]
        return np.abs(image.astype(float) / image[hit].mean() - shown / shown[hit].mean())[10:-10, 10:-10][inner].mean()

    assert difference(picture) < 0.6 * difference(np.roll(picture, 2, axis=1))
    assert difference(picture) < 0.6 * difference(np.roll(picture, 2, axis=0))


def test_exposures_are_made_equal(room, made):
    """Their spread of a third is gone: seen from all cameras, the brightness over the truth is the same."""
    ratio = [np.median(picture / true) for picture, true, _ in (errors(made.mesh, room[2], k) for k in range(6))]
    assert max(ratio) / min(ratio) < 1.06


def test_the_board_leaves_no_shadow_on_the_wall(room, made):
    """What hides a part of the wall from some views is not painted onto it."""
    at_wall = np.abs(made.mesh.vertices[made.mesh.triangles][:, :, 2] - 2).max(axis=1) < 0.02
    uv = made.mesh.texture.uv[made.mesh.triangles[at_wall]].mean(axis=1)
    height, width = made.mesh.texture.image.shape[:2]
    color = made.mesh.texture.image[(uv[:, 1] * height).astype(int), (uv[:, 0] * width).astype(int)].astype(int)
    red = (color[:, 0] > 150) & (color[:, 1] < 70) & (color[:, 2] < 70)
    assert at_wall.sum() > 3000 and red.mean() < 0.005


def test_a_blurred_image_is_the_least_sharp(room):
    images = [cv2.imread(str(room[1] / "rgb" / f"{k}.0.png"))[..., ::-1] for k in range(6)]
    values = [sharpness(image) for image in images]
    assert np.argmin(values) == BLURRED
    assert sorted(values)[1] > 1.2 * values[BLURRED]


@pytest.mark.parametrize("name", ["wall.glb", "wall.obj", "wall.ply"])
def test_command_writes_the_file_that_is_named(room, tmp_path, name):
    pytest.importorskip("open3d", exc_type=ImportError)
    arguments = [str(room[0]), "--sequence", str(room[1]), "--voxel", "0.04", "-o", str(tmp_path / name)]
    outcome = CliRunner().invoke(mesh_command, arguments, catch_exceptions=False)
    assert outcome.exit_code == 0 and str(tmp_path / name) in outcome.stdout
    assert (tmp_path / name).is_file()
    textured = name != "wall.ply"
    assert ("texture of" in outcome.stdout) == textured
    beside = {"wall.obj": {"wall.mtl", "wall.jpg"}}.get(name, set())
    assert {path.name for path in tmp_path.iterdir()} == {name} | beside


@pytest.mark.parametrize("name", ["wall.stl", "wall.gltf"])
def test_other_formats_are_refused_before_the_work(room, tmp_path, name):
    outcome = CliRunner().invoke(mesh_command, [str(room[0]), "-o", str(tmp_path / name)])
    assert outcome.exit_code == 2 and ".glb, .obj, .ply" in outcome.output
    assert not (tmp_path / name).exists()


@pytest.mark.real
@pytest.mark.slow
@pytest.mark.skipif(not REAL, reason="MINILOOP_TUM is not set")
def test_real_frames_look_like_their_images(tmp_path):
    """Twelve frames of a desk at their true poses: a view of the textured mesh is the image, nearly everywhere."""
    pytest.importorskip("open3d", exc_type=ImportError)
    sequence = open_sequence(Path(REAL) / "freiburg1_xyz_100", max_frames=12)
    T = interpolate(read_ground_truth(sequence), sequence.stamps_s)
    write_trajectory(tmp_path / "trajectory.txt", Trajectory(sequence.stamps_s, T))
    made = make_mesh(Model(Results(tmp_path), sequence), Wishes(0.02, texture=True), quiet=True)
    undistort = undistorter(sequence.camera)
    for k in (2, 6, 10):
        picture, hit = rendered(made.mesh, T[k], sequence.camera)
        scan = undistort(read_scan(sequence, k))
        both = cv2.erode((hit & (scan.color.max(axis=2) > 0)).astype(np.uint8), np.ones((9, 9))) > 0
        assert both.mean() > 0.4
        grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[both].astype(float) for image in (picture, scan.color)]
        assert np.corrcoef(*grey)[0, 1] > 0.9


def test_gains_are_found_again():
    rng = np.random.default_rng(1)
    true = np.exp(rng.normal(scale=0.2, size=(8, 3)))
    true /= np.exp(np.log(true).mean(axis=0))
    albedo = rng.uniform(50, 120, (400, 3))
    view, point = rng.integers(0, 8, 3000), rng.integers(0, 400, 3000)
    colors = albedo[point] / true[view]
    colors[rng.random(3000) < 0.1] = 40  # wrong places
    np.testing.assert_allclose(gains(view, point, colors.astype(np.float32), 8), true, rtol=0.02)
    assert (gains(view[:0], point[:0], colors[:0].astype(np.float32), 8) == 1).all()


def test_a_step_is_levelled_and_fades_away():
    """Two halves of a sheet, 40 apart: no step is left where they meet, and the far ends keep their colour."""
    mesh = sheet(1.0, 61)
    left = mesh.vertices[mesh.triangles][:, :, 0].mean(axis=1) < 0.5
    keys = mesh.triangles + np.int64(len(mesh.vertices)) * left[:, None]
    nodes, corners = np.unique(keys, return_inverse=True)
    vertex, of_left = nodes % len(mesh.vertices), nodes >= len(mesh.vertices)
    colors = np.repeat(np.where(of_left, 140, 100)[:, None], 3, axis=1).astype(np.float32)
    pairs = seam_pairs(vertex)
    assert len(pairs) == 61
    after = colors + level(corners.reshape(-1, 3).astype(np.int32), pairs, colors)
    assert np.abs(after[pairs[:, 0]] - after[pairs[:, 1]]).max() < 2
    assert after[pairs].mean() == pytest.approx(120, abs=1)
    far = mesh.vertices[vertex, 0]
    assert after[far < 0.02].mean() > 133 and after[far > 0.98].mean() < 107


def test_labels_are_smooth_where_views_are_equally_good():
    """Two views as good as each other but for noise: few patches; where one sees nothing, the other is taken."""
    mesh, rng = sheet(1.0, 50), np.random.default_rng(2)
    count = len(mesh.triangles)
    view = np.tile(np.array([0, 1], np.int16), (count, 1))
    quality = (1 + 0.1 * rng.normal(size=(count, 2))).astype(np.float32)
    x = mesh.vertices[mesh.triangles][:, :, 0].mean(axis=1)
    view[x < 0.3, 1], quality[x < 0.3, 1] = -1, 0
    quality[x > 0.7, 1] *= 5
    label = choose_labels(mesh, view, quality)
    assert (label[x < 0.3] == 0).all() and (label[x > 0.72] == 1).all()
    assert len(np.unique(patches(label, face_pairs(mesh.triangles)))) < 8
    view[:] = -1
    assert (choose_labels(mesh, view, np.zeros_like(quality)) == -1).all()


def test_packed_rectangles_do_not_overlap():
    sizes = np.random.default_rng(3).integers(1, 60, (300, 2))
    corners, width, height = pack(sizes)
    taken = np.zeros((height, width), np.uint8)
    for (x, y), (w, h) in zip(corners, sizes, strict=True):
        taken[y : y + h, x : x + w] += 1
    assert taken.max() == 1 and taken.sum() == (sizes[:, 0] * sizes[:, 1]).sum()
    assert taken.mean() > 0.8
