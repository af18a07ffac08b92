"""Every format opened by its own tool: the same camera centres and rotations to 1e-6."""

import json
import subprocess
import sys

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.cli.export import FORMATS, export
from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import InputError
from miniloop_cli.export.colmap import write_colmap
from miniloop_cli.export.model import Model
from miniloop_cli.export.nerfstudio import write_nerfstudio
from miniloop_cli.export.open3d_json import write_open3d
from miniloop_cli.export.plain import write_clouds, write_graph, write_kitti, write_numpy, write_tum
from miniloop_cli.geometry import se3
from miniloop_cli.results.folder import Results


def same(T, expected):
    np.testing.assert_allclose(np.asarray(T), expected, atol=1e-6)


def test_tum(run, tmp_path):
    (path,) = write_tum(run.model, tmp_path / "out")
    back = read_trajectory(path)
    same(back.T_world_cam, run.T)
    evo = pytest.importorskip("evo.tools.file_interface")
    read = evo.read_tum_trajectory_file(path)
    same(np.array(read.poses_se3), run.T)
    np.testing.assert_allclose(read.timestamps, run.model.trajectory.timestamps_s, atol=1e-6)


def test_kitti(run, tmp_path):
    poses, times = write_kitti(run.model, tmp_path)
    same(np.loadtxt(poses).reshape(-1, 3, 4), run.T[:, :3])
    np.testing.assert_allclose(np.loadtxt(times), run.model.trajectory.timestamps_s, atol=1e-6)
    evo = pytest.importorskip("evo.tools.file_interface")
    same(np.array(evo.read_kitti_poses_file(poses).poses_se3), run.T)


def test_g2o(run, tmp_path):
    gtsam = pytest.importorskip("gtsam")
    (path,) = write_graph(run.model, tmp_path)
    factors, values = gtsam.readG2o(str(path), True)
    same([values.atPose3(int(k)).matrix() for k in run.kept], run.T)
    assert factors.size() == len(run.rows)
    assert factors.error(values) == pytest.approx(0, abs=1e-9)  # the edges are exact: signs and orders are right


def test_open3d(run, tmp_path):
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    graph_path, trajectory_path = write_open3d(run.model, tmp_path)
    graph = o3d.io.read_pose_graph(str(graph_path))
    same([node.pose for node in graph.nodes], run.T)
    assert [(e.source_node_id, e.target_node_id) for e in graph.edges] == [tuple(r) for r in run.rows]
    for edge in graph.edges:
        source, target = run.T[edge.source_node_id], run.T[edge.target_node_id]
        same(target @ edge.transformation, source)
        same(edge.information, edge.information.T)
    assert [edge.uncertain for edge in graph.edges] == [False, False, False, True, True]
    trajectory = o3d.io.read_pinhole_camera_trajectory(str(trajectory_path))
    same([np.linalg.inv(p.extrinsic) for p in trajectory.parameters], run.T)
    same(trajectory.parameters[0].intrinsic.intrinsic_matrix, run.model.sequence.camera.K)


def test_open3d_information_is_rotation_first(run, tmp_path):
    """A node that Open3D may turn at no cost, but not move, if the order is right."""
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    graph = run.model.graph
    information = np.zeros_like(graph.information)
    information[:, 3:, 3:] = 1e4 * np.eye(3)
    model = Model(run.model.results)
    model.__dict__["graph"] = type(graph)(graph.ids, graph.T_world_cam, graph.pairs, graph.T_j_i, information)
    read = o3d.io.read_pose_graph(str(write_open3d(model, tmp_path)[0]))
    for edge, expected in zip(read.edges, information, strict=True):
        same(edge.information, expected)


def test_colmap(run, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    write_colmap(run.model, tmp_path)
    read = pycolmap.Reconstruction(str(tmp_path / "sparse"))
    images = [read.images[int(k) + 1] for k in run.kept]
    same([image.projection_center() for image in images], run.T[:, :3, 3])
    same([image.cam_from_world().matrix() for image in images], se3.inverse(run.T)[:, :3])
    assert len(read.points3D) == 500
    camera = run.model.sequence.camera
    colmap_camera = read.cameras[1]
    p_cam = np.array([[0.2, -0.1, 1.5], [-0.3, 0.2, 2.0]])
    same(colmap_camera.img_from_cam(p_cam), camera.project(p_cam) + 0.5)
    for image in images:
        assert (tmp_path / "images" / image.name).exists()
        data = (tmp_path / "stereo" / "depth_maps" / f"{image.name}.geometric.bin").read_bytes()
        header, body = data[:10], data[10:]
        assert header == b"160&120&1&"
        depth = np.frombuffer(body, "<f4").reshape(120, 160)
        assert depth[60, 80] == pytest.approx(1.5)


def test_colmap_images_show_what_the_ideal_camera_sees(run, tmp_path):
    """A square drawn where the lens puts a point is found where the exported pinhole camera puts it."""
    camera = run.model.sequence.camera
    ideal = np.array([[20.0, 20.0], [140.0, 100.0], [80.0, 15.0]])
    path = run.model.sequence.frames[0].color.path
    grid = np.stack(np.meshgrid(np.arange(160), np.arange(120)), axis=-1).reshape(-1, 2).astype(float)
    near = np.linalg.norm(camera.undistort(grid)[:, None] - ideal, axis=2).min(axis=1) < 2
    cv2.imwrite(str(path), np.where(near, 255, 0).astype(np.uint8).reshape(120, 160, 1).repeat(3, axis=2))
    write_colmap(run.model, tmp_path)
    seen = cv2.imread(str(tmp_path / "images" / "000000.png"), cv2.IMREAD_GRAYSCALE)
    _, _, _, centres = cv2.connectedComponentsWithStats((seen > 128).astype(np.uint8))
    distances = np.linalg.norm(centres[1:, None] - ideal, axis=2)
    assert distances.min(axis=0).max() < 0.6


def test_nerfstudio(run, tmp_path):
    path, _ = write_nerfstudio(run.model, tmp_path / "out")
    data = json.loads(path.read_text())
    T = np.array([frame["transform_matrix"] for frame in data["frames"]])
    same(T @ np.diag([1, -1, -1, 1]), run.T)
    first = data["frames"][0]
    for key in ("file_path", "depth_file_path"):
        assert (path.parent / first[key]).resolve().is_file()
    depth = cv2.imread(str(path.parent / first["depth_file_path"]), cv2.IMREAD_UNCHANGED)
    assert depth[0, 0] * data["depth_unit_scale_factor"] == pytest.approx(1.5)
    # A point before the camera has negative z in OpenGL's axes and projects as ours, half a pixel on.
    p_cam = np.array([0.2, -0.1, 1.5])
    p_gl = np.linalg.inv(T[0]) @ run.T[0] @ np.r_[p_cam, 1]
    px = np.array([data["fl_x"] * p_gl[0] / -p_gl[2] + data["cx"], data["fl_y"] * -p_gl[1] / -p_gl[2] + data["cy"]])
    same(px, run.model.sequence.camera.project(p_cam[None])[0] + 0.5)


def test_numpy(run, tmp_path):
    (path,) = write_numpy(run.model, tmp_path)
    with np.load(path, allow_pickle=False) as data:
        same(data["T_world_cam"], run.T)
        assert data["frames"].tolist() == run.kept.tolist()
        rows = np.searchsorted(data["frames"], data["pairs"])
        same(data["T_world_cam"][rows[:, 1]] @ data["T_j_i"], data["T_world_cam"][rows[:, 0]])
        assert "maps points" in str(data["conventions"])
        same(data["K"], run.model.sequence.camera.K)


def test_ply(run, tmp_path):
    cameras, cloud = write_clouds(run.model, tmp_path)
    assert cloud.read_bytes() == (run.results / "cloud.ply").read_bytes()
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    same(np.asarray(o3d.io.read_point_cloud(str(cameras)).points), run.T[:, :3, 3])


@pytest.mark.parametrize("name", list(FORMATS))
def test_command(run, name):
    arguments = [str(run.results), "--to", name, "--sequence", str(run.sequence)]
    outcome = CliRunner().invoke(export, arguments, catch_exceptions=False)
    paths = outcome.stdout.split("\n")[:-1]
    assert paths
    for path in paths:
        assert path.startswith(str(run.results / name))
    assert CliRunner().invoke(export, [*arguments, "-q"], catch_exceptions=False).output == ""


@pytest.mark.parametrize("name", FORMATS)
def test_no_file_is_written_that_is_not_told(run, tmp_path, name):
    arguments = [str(run.results), "--sequence", str(run.sequence), "--to", name, "-o", str(tmp_path)]
    told = CliRunner().invoke(export, arguments, catch_exceptions=False).stdout.split("\n")
    assert {str(path) for path in tmp_path.iterdir() if path.is_file()} <= set(told)


@pytest.mark.parametrize("name", ["colmap", "nerfstudio"])
def test_the_recording_is_asked_for(run, tmp_path, name):
    write = {"colmap": write_colmap, "nerfstudio": write_nerfstudio}[name]
    with pytest.raises(InputError, match="--sequence"):
        write(Model(Results(run.results)), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_another_recording_is_refused(run, tmp_path):
    other = tmp_path / "other"
    for kind in ("rgb", "depth"):
        (other / kind).mkdir(parents=True)
        for frame in run.model.sequence.frames[:3]:
            path = (frame.color if kind == "rgb" else frame.depth).path
            (other / kind / f"{frame.timestamp_s + 7:.6f}.png").write_bytes(path.read_bytes())
    (other / "camera.yaml").write_bytes((run.sequence / "camera.yaml").read_bytes())
    with pytest.raises(InputError, match="another recording"):
        write_colmap(Model(Results(run.results), open_sequence(other)), tmp_path / "out")


def test_a_graph_of_another_run_is_refused(run, tmp_path):
    lines = (run.results / "trajectory.txt").read_text().splitlines()
    (run.results / "trajectory.txt").write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(InputError, match="different runs"):
        write_numpy(Model(Results(run.results)), tmp_path)


def test_without_a_graph_the_poses_remain(run, tmp_path):
    (run.results / "graph.g2o").unlink()
    (run.results / "frames.csv").unlink()
    (path,) = write_graph(Model(Results(run.results)), tmp_path)
    assert path.read_text().count("VERTEX_SE3") == 7


def test_open3d_is_not_needed_to_write(run):
    code = (
        "import sys; sys.modules['open3d'] = None; from miniloop_cli.cli.export import export;"
        f"export.main([{str(run.results)!r}, '--to', 'open3d', '--to', 'g2o', '--to', 'ply'], standalone_mode=False)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
