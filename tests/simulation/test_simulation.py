"""Simulated recordings: exact geometry, the stated noise, the same bytes for the same seed."""

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.cli import simulate as command
from miniloop_cli.datasets import open_sequence, read_ground_truth, read_scan
from miniloop_cli.errors import ConfigError, MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import DepthNoise
from miniloop_cli.simulation import sensor, simulate
from miniloop_cli.simulation.render import NOTHING, render
from miniloop_cli.simulation.scene import Scene
from miniloop_cli.simulation.settings import PATHS, SCENES, SimulationSettings
from miniloop_cli.simulation.simulate import true_trajectory
from miniloop_cli.simulation.write import write_sequence

TUM_LENS = (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)


def frames_of(seed=0, **changes):
    settings = SimulationSettings(**({"frames": 2, "width": 160, "height": 120, "noise": False} | changes))
    return settings.camera, list(simulate(settings, np.random.default_rng(seed)))


def one_box_scene() -> Scene:
    """A cube of 1 m around the origin and a sphere of 0.5 m at x = 2 m; red falls with x, green with z on the faces."""
    scene = Scene()

    def paint(face, width_m, height_m):
        image = np.full((100, 100, 3), 128, np.uint8)
        image[:, :, 0] = np.linspace(0, 255, 100)
        image[:, :, 1] = np.linspace(0, 255, 100)[:, None]
        return image, 100.0

    scene.add_box(np.zeros(3), np.full(3, 0.5), 0.0, paint)
    scene.add_sphere(np.array([2.0, 0, 0]), 0.5, np.full((50, 157, 3), 90, np.uint8))
    return scene


def test_rays_meet_box_and_sphere_where_algebra_says():
    # A camera 3 m before the face y = -0.5, looking along +y: x right, z up.
    T = np.array([[1.0, 0, 0, 0], [0, 0, 1, -3.5], [0, -1, 0, 0], [0, 0, 0, 1]])
    u, v = np.meshgrid(np.linspace(-1, 1, 81), np.linspace(-0.6, 0.6, 41))
    rays = np.stack([u, v, np.ones_like(u)], -1)
    color, depth, cosine, hit = render(rays, np.broadcast_to(T, (41, 4, 4)).copy(), 0.002, one_box_scene().arrays())
    on_face = (np.abs(u * 3) < 0.499) & (np.abs(v * 3) < 0.499)
    assert (hit[on_face] == 0).all()
    np.testing.assert_allclose(depth[on_face], 3.0, rtol=1e-6)
    np.testing.assert_allclose(cosine[on_face], 1 / np.sqrt(1 + u**2 + v**2)[on_face], rtol=1e-5)
    # |o + t d|^2 = r^2 about the centre of the sphere
    o = np.array([-2.0, -3.5, 0])
    d = np.stack([u, np.ones_like(u), -v], -1)
    a, b, c = (d * d).sum(-1), d @ o, o @ o - 0.25
    root = b * b - a * c
    expected = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, 0)
    sphere = (root > 0) & (np.abs(u * 3) > 0.6)
    assert sphere.sum() > 20 and (hit[sphere] == 1).all()
    np.testing.assert_allclose(depth[sphere], expected[sphere], rtol=1e-5)
    assert (hit[~on_face & ~sphere & (np.abs(u * 3) > 0.52) & (root <= 0)] == NOTHING).all()
    assert (depth[hit == NOTHING] == 0).all()
    # Faces are seen upright and from left to right.
    row, column = np.where(on_face)
    left, right = column[on_face[row, column]].min(), column.max()
    assert color[20, right, 0] > color[20, left, 0] + 100
    assert color[row.max(), 40, 1] > color[row.min(), 40, 1] + 100


@pytest.mark.slow
def test_depth_and_poses_agree_between_frames():
    """Points of one frame, moved by the true relative pose, lie on the depth and have the colour of the other."""
    camera, (a, b) = frames_of(frames=2, rate_hz=40.0, path="xyz", distortion=TUM_LENS)
    z = a.depth / camera.depth_scale
    v, u = np.nonzero(z)
    px = np.stack([u, v], 1).astype(float)
    p_b = se3.transform(se3.inverse(b.T_world_cam) @ a.T_world_cam, camera.backproject(camera.undistort(px), z[v, u]))
    K, D = camera.K, np.array(camera.lens.coefficients)
    seen = cv2.projectPoints(p_b, np.zeros(3), np.zeros(3), K, D)[0][:, 0]
    column, row = np.round(seen).astype(int).T
    inside = (column >= 1) & (column < camera.width - 1) & (row >= 1) & (row < camera.height - 1)
    assert inside.mean() > 0.5
    there = b.depth[row[inside], column[inside]] / camera.depth_scale
    error = np.abs(there - p_b[inside, 2])
    assert np.median(error) < 2e-3 and np.mean(error < 0.02) > 0.93
    close = error < 0.01
    difference = np.abs(
        a.color[v[inside], u[inside]][close].astype(float) - b.color[row[inside], column[inside]][close]
    )
    shuffled = np.abs(
        a.color[v[inside], u[inside]][close][::-1].astype(float) - b.color[row[inside], column[inside]][close]
    )
    assert np.median(difference) < 8 < np.median(shuffled)


def test_depth_noise_has_the_stated_deviation():
    noise, rng = DepthNoise(), np.random.default_rng(0)
    for z in (0.8, 1.5, 3.0, 4.5):
        wall = np.full((240, 320), z, np.float32)
        measured = sensor.measure_depth(wall, np.ones_like(wall), noise, rng)
        valid = measured > 0
        assert 0.95 < valid.mean() < 1
        sigma = float(noise.sigma_m(np.array(z)))
        assert abs(measured[valid].mean() - z) < 0.1 * sigma
        assert measured[valid].std() == pytest.approx(sigma, rel=0.12)
        step = z * z / (8 * 580 * 0.075)
        values = np.unique(measured[valid])
        if len(values) > 1:
            assert np.diff(values).min() == pytest.approx(step, rel=0.2)


def test_holes_at_grazing_angles_edges_and_range():
    rng, noise = np.random.default_rng(0), DepthNoise()
    depth = np.full((100, 200), 1.0, np.float32)
    depth[:, 100:] = 2.0
    cosine = np.ones_like(depth)
    cosine[:20] = 0.1
    measured = sensor.measure_depth(depth, cosine, noise, rng)
    assert (measured[:20] == 0).all() and (measured[25:, 99:101] == 0).mean() > 0.5 > (measured[25:, 110:] == 0).mean()
    assert (np.abs(measured[25:, :95][measured[25:, :95] > 0] - 1) < 0.05).all()
    stored = sensor.store_depth(np.array([[0.0, 0.39, 0.41, 4.99, 5.01, 13.2]], np.float32), 5000, 5.0)
    assert stored.tolist() == [[0, 0, 2050, 24950, 0, 0]]
    assert sensor.store_depth(np.array([[14.0]], np.float32), 5000, 20.0).tolist() == [[65535]]


@pytest.mark.parametrize("path", PATHS)
def test_paths_are_smooth_and_stay_in_the_room(path):
    settings = SimulationSettings(frames=100, path=path)
    trajectory = true_trajectory(settings, np.random.default_rng(3))
    T = trajectory.T_world_cam
    assert (np.diff(trajectory.timestamps_s) > 0).all()
    np.testing.assert_allclose(
        T[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2), np.broadcast_to(np.eye(3), (len(T), 3, 3)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(T[:, :3, :3]), 1)
    assert (np.abs(T[:, :2, 3]) < [1.8, 1.4]).all() and (T[:, 2, 3] > 0.5).all() and (T[:, 2, 3] < 2.2).all()
    travelled = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    turned = se3.rotation_angle_deg(np.swapaxes(T[:-1, :3, :3], 1, 2) @ T[1:, :3, :3])
    assert travelled.max() < 0.05 and turned.max() < 3
    assert (travelled.sum() > 1) == (path not in ("rotation", "still")) and (turned.sum() > 20) == (path != "still")


def test_loop_ends_where_it_began():
    trajectory = true_trajectory(SimulationSettings(frames=30), np.random.default_rng(0))
    T = trajectory.T_world_cam
    between = se3.inverse(T) @ T[0]
    angle, distance = se3.rotation_angle_deg(between[:, :3, :3]), np.linalg.norm(between[:, :3, 3], axis=1)
    late = len(T) * 3 // 4
    assert angle[len(T) // 2] > 90 and ((angle[late:] < 25) & (distance[late:] < 0.6)).any()


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_scenes_fill_the_view(scene):
    _, frames = frames_of(scene=scene, frames=4)
    for frame in frames:
        assert (frame.depth > 0).mean() > 0.97
        assert scene == "textureless" or frame.color.std() > 20
    if scene == "plane":  # one plane explains all points
        camera = SimulationSettings(width=160, height=120).camera
        z = frames[0].depth / camera.depth_scale
        v, u = np.mgrid[:120, :160]
        points = camera.backproject(np.stack([u.ravel(), v.ravel()], 1), z.ravel())
        assert np.linalg.svd(points - points.mean(0), compute_uv=False)[2] / np.sqrt(len(points)) < 1e-3
    if scene == "two-rooms":
        assert frames[1].T_world_cam[0, 3] < 5 < 20 < frames[2].T_world_cam[0, 3]


@pytest.mark.slow
def test_features_are_plenty_except_where_asked_otherwise():
    detectors = {"sift": cv2.SIFT_create(3000), "orb": cv2.ORB_create(3000)}
    for scene, wanted in (("room", 250), ("textureless", None)):
        _, frames = frames_of(scene=scene, width=640, height=480, frames=6, noise=True)
        for frame in frames:
            gray = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY)
            counts = {name: len(detector.detect(gray)) for name, detector in detectors.items()}
            assert all(n > wanted for n in counts.values()) if wanted else counts["sift"] < 150, (scene, counts)


@pytest.mark.slow
def test_surf_finds_enough_too():
    surf = pytest.importorskip("mahotas.features.surf")
    _, frames = frames_of(width=640, height=480, frames=3, noise=True)
    for frame in frames:
        assert len(surf.surf(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), threshold=0.1)) > 250


@pytest.mark.slow
def test_moving_object_moves_and_is_masked():
    _, with_figure = frames_of(moving_object=True, frames=3)
    _, without = frames_of(moving_object=False, frames=3)
    for a, b in zip(with_figure, without, strict=True):
        assert 0.15 < a.moving.mean() < 0.45
        np.testing.assert_array_equal(a.depth[~a.moving], b.depth[~a.moving])
        assert (a.depth[a.moving] < b.depth[a.moving]).mean() > 0.95


@pytest.mark.slow
def test_blur_shutter_and_exposure_change_what_they_should():
    def sharpness(frame):
        return cv2.Laplacian(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), cv2.CV_64F).var()

    _, plain = frames_of(frames=30)
    _, blurred = frames_of(frames=30, blur_s=0.05)
    assert sharpness(blurred[3]) < 0.3 * sharpness(plain[3])
    np.testing.assert_array_equal(blurred[3].depth, plain[3].depth)
    _, bright = frames_of(exposure=3.0)
    assert (bright[0].color == 255).mean() > 0.5 > (plain[0].color == 255).mean()
    _, rolled = frames_of(frames=30, rolling_shutter_s=0.03)
    middle = slice(58, 62)
    difference = np.abs(rolled[3].depth.astype(int) - plain[3].depth)
    assert np.median(difference[middle]) < np.median(difference[:10]) and np.median(difference[:10]) > 5


@pytest.mark.slow
def test_written_folder_reads_back_and_repeats(tmp_path):
    settings = SimulationSettings(frames=3, width=160, height=120, distortion=TUM_LENS, moving_object=True, masks=True)
    one = write_sequence(tmp_path / "one", settings, seed=5)
    two = write_sequence(tmp_path / "two", settings, seed=5)
    other = write_sequence(tmp_path / "other", settings, seed=6)

    def content(folder):
        return {p.relative_to(folder): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}

    assert content(one) == content(two) and content(one) != content(other)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one", "other", "two"]
    sequence = open_sequence(one)
    frames = list(simulate(settings, np.random.default_rng(5)))
    assert (
        sequence.camera.source == "the sequence's own camera.yaml"
        and sequence.camera.K.tolist() == settings.camera.K.tolist()
    )
    assert sequence.camera.lens.coefficients == TUM_LENS
    truth = read_ground_truth(sequence)
    for k, frame in enumerate(frames):
        scan = read_scan(sequence, k)
        np.testing.assert_array_equal(scan.color, frame.color)
        np.testing.assert_array_equal(scan.mask, frame.moving)
        expected = frame.scan(settings.camera).depth_m
        expected[frame.moving] = 0
        np.testing.assert_array_equal(scan.depth_m, expected)
        at = np.flatnonzero(truth.timestamps_s == sequence.frames[k].timestamp_s)
        assert len(at) == 1
        np.testing.assert_allclose(truth.T_world_cam[at[0]], frame.T_world_cam, atol=1e-8)


@pytest.mark.slow
def test_the_scene_does_not_depend_on_the_sensor():
    _, clean = frames_of(seed=4)
    _, noisy = frames_of(seed=4, noise=True)
    np.testing.assert_array_equal(clean[1].T_world_cam, noisy[1].T_world_cam)
    valid = noisy[1].depth > 0
    assert np.median(np.abs(clean[1].depth[valid] / 5000 - noisy[1].depth[valid] / 5000)) < 0.03


@pytest.mark.slow
def test_command_refuses_what_it_would_destroy(tmp_path):
    run = CliRunner().invoke
    small = ["--frames", "1", "--width", "64", "--height", "48", "-q"]
    folder = tmp_path / "room"
    assert run(command.simulate, [str(folder), *small]).exit_code == 0
    first = (folder / "rgb.txt").stat().st_ino
    assert isinstance(run(command.simulate, [str(folder), *small]).exception, MiniloopError)
    assert (folder / "rgb.txt").stat().st_ino == first
    assert run(command.simulate, [str(folder), *small, "--overwrite", "--seed", "1"]).exit_code == 0
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("precious")
    result = run(command.simulate, [str(mine), *small, "--overwrite"])
    assert isinstance(result.exception, MiniloopError) and "holds other files" in str(result.exception)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine", "room"]
    (tmp_path / "file").touch()
    for bad in (tmp_path / "file", tmp_path / "file" / "inner"):
        assert isinstance(run(command.simulate, [str(bad), *small]).exception, MiniloopError)


@pytest.mark.slow
def test_an_interrupted_run_leaves_nothing(tmp_path):
    def stop(frames):
        yield next(iter(frames))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_sequence(tmp_path / "room", SimulationSettings(frames=3, width=64, height=48), progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_command_offers_what_the_settings_know():
    assert command.SCENES == SCENES and command.PATHS == PATHS
    with pytest.raises(ConfigError, match="unknown scene 'rom'; did you mean 'room'"):
        SimulationSettings(scene="rom")
    with pytest.raises(ConfigError, match="frames must be from 1 to 100000, not 0"):
        SimulationSettings(frames=0)


def test_a_texture_does_not_slide_over_its_surface_with_the_distance():
    """Every level of a pyramid is half of the one before: an edge at texel x is at x / 2^k in level k."""
    image = np.zeros((333, 1287, 3), np.uint8)
    image[:, 1264:] = 200
    scene = Scene()
    scene.add_texture(image, 280.0)
    for level, texels in enumerate(scene.pyramids[0]):
        assert texels.shape[1] * 2**level == scene.pyramids[0][0].shape[1]
        assert 1264 / 2**level == 1 + np.flatnonzero(texels[0, :, 0] < 100)[-1]
    assert np.array_equal(scene.pyramids[0][0][:333, :1287], image)
