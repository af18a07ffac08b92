"""The fused surface of a known shape, its memory bound, and the message without Open3D."""

import sys

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.cli.mesh import mesh
from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.intrinsics import save_camera
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.errors import MiniloopError
from miniloop_cli.export.mesh import BYTES_A_BLOCK, fuse, import_open3d
from miniloop_cli.export.model import Model
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.results.folder import Results
from miniloop_cli.results.ply import read_ply
from miniloop_cli.scene.sequence import Trajectory


@pytest.fixture
def wall(tmp_path):
    """Five views of the plane z = 2 m, red for x < 0, blue beyond, by cameras that shift and turn."""
    camera = Camera(120, 120, 79.5, 59.5, 160, 120)
    sequence, results = tmp_path / "wall", tmp_path / "results"
    for kind in ("rgb", "depth"):
        (sequence / kind).mkdir(parents=True)
    save_camera(sequence / "camera.yaml", camera)
    w = np.array([[0, a, 0] for a in (-0.2, -0.1, 0, 0.1, 0.2)])
    T = se3.pose(se3.exp_so3(w), np.array([[0.1 * k, 0, 0] for k in range(-2, 3)]))
    px = np.stack(np.meshgrid(np.arange(160.0), np.arange(120.0)), axis=-1).reshape(-1, 2)
    rays = camera.backproject(px, np.ones(len(px)))
    for k, pose in enumerate(T):
        direction = rays @ pose[:3, :3].T
        z_cam = (2 - pose[2, 3]) / direction[:, 2]  # of the camera: rays have unit depth
        x_world = pose[0, 3] + z_cam * direction[:, 0]
        color = np.where(x_world[:, None] < 0, [0, 0, 255], [255, 0, 0]).astype(np.uint8)  # BGR
        cv2.imwrite(str(sequence / "rgb" / f"{k}.0.png"), color.reshape(120, 160, 3))
        cv2.imwrite(str(sequence / "depth" / f"{k}.0.png"), np.rint(5000 * z_cam).astype(np.uint16).reshape(120, 160))
    write_trajectory(results / "trajectory.txt", Trajectory(np.arange(5.0), T))
    return results, sequence


def test_a_wall_comes_out_flat_and_coloured(wall):
    pytest.importorskip("open3d", exc_type=ImportError)
    results, sequence = wall
    surface = fuse(Model(Results(results), open_sequence(sequence)), voxel_m=0.02, quiet=True)
    assert len(surface.triangles) > 1000
    assert np.abs(surface.vertices[:, 2] - 2).max() < 0.01
    assert np.ptp(surface.vertices[:, 0]) > 1.5
    left, right = surface.vertices[:, 0] < -0.05, surface.vertices[:, 0] > 0.05
    assert (surface.colors[left] == [255, 0, 0]).mean() > 0.99
    assert (surface.colors[right] == [0, 0, 255]).mean() > 0.99
    assert surface.triangles.max() < len(surface.vertices)
    assert np.abs(surface.points[:, 2] - 2).max() < 0.01


def test_little_memory_gives_larger_voxels(wall):
    pytest.importorskip("open3d", exc_type=ImportError)
    results, sequence = wall
    model = Model(Results(results), open_sequence(sequence))
    surface = fuse(model, voxel_m=0.01, memory_mb=int(60 * BYTES_A_BLOCK / 1e6), quiet=True)
    assert surface.voxel_m > 0.02
    assert np.abs(surface.vertices[:, 2] - 2).max() < 0.02


def test_command_skips_a_broken_frame(wall):
    pytest.importorskip("open3d", exc_type=ImportError)
    results, sequence = wall
    (sequence / "depth" / "1.0.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    arguments = [str(results), "--sequence", str(sequence), "--voxel", "0.04"]
    outcome = CliRunner().invoke(mesh, arguments, catch_exceptions=False)
    assert "skipped frame 1" in outcome.stderr
    assert len(read_ply(results / "mesh.ply")[0]) > 100
    assert len(read_ply(results / "fused_cloud.ply")[0]) > 100


def test_nothing_in_range_is_said(wall):
    pytest.importorskip("open3d", exc_type=ImportError)
    results, sequence = wall
    with pytest.raises(MiniloopError, match="--max-depth"):
        fuse(Model(Results(results), open_sequence(sequence)), max_depth_m=0.5, quiet=True)


def test_missing_system_packages_are_named(monkeypatch):
    class Broken:
        def find_spec(self, name, path=None, target=None):
            if name == "open3d":
                raise ImportError("libusb-1.0.so.0: cannot open shared object file")

    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Broken(), *sys.meta_path])
    with pytest.raises(MiniloopError, match=r"apt-get install libegl1 libgl1 libgomp1 libidn2-0 libusb-1\.0-0"):
        import_open3d()
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MiniloopError, match="open3d"):
        import_open3d()
