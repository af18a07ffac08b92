"""What becomes of each lens in each format: its own model where the format has one, else undistorted images."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from miniloop_cli.datasets.camera_files import read_camera_file
from miniloop_cli.export.colmap import write_colmap
from miniloop_cli.export.model import Model
from miniloop_cli.export.nerfstudio import write_nerfstudio
from miniloop_cli.export.open3d_json import write_open3d
from miniloop_cli.export.plain import write_numpy
from miniloop_cli.export.undistort import undistorter
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import PINHOLE, fisheye_lens, radial_tangential_lens
from miniloop_cli.results.folder import Results
from miniloop_cli.scene.sequence import Scan

RATIONAL = radial_tangential_lens(0.5, -2.6, 0.001, -0.002, 1.5, 0.38, -2.4, 1.4)
LENSES = [PINHOLE, radial_tangential_lens(0.1, -0.02, 0.001), RATIONAL, fisheye_lens(0.01, 0.002)]


def through(run, lens):
    sequence = run.model.sequence
    return Model(Results(run.results), replace(sequence, camera=replace(sequence.camera, lens=lens)))


@pytest.mark.parametrize("lens", LENSES, ids=str)
def test_cameras_are_read_back(run, tmp_path, lens):
    """The lens stands in the file, or the images are undistorted and the camera is a pinhole."""
    model = through(run, lens)
    camera = model.recording.camera
    ideal = replace(camera, lens=PINHOLE)
    files = {
        "colmap": (write_colmap(model, tmp_path / "colmap")[0], ideal),
        "open3d": (write_open3d(model, tmp_path / "open3d")[-1], ideal),
        "nerfstudio": (write_nerfstudio(model, tmp_path / "nerfstudio")[0], ideal if lens == RATIONAL else camera),
    }
    for path, expected in files.values():
        read = read_camera_file(path, depth_scale=5000.0)
        assert read.lens == expected.lens
        np.testing.assert_allclose(read.K, expected.K, atol=1e-9)
        assert (read.width, read.height) == (camera.width, camera.height)
        assert read.depth_scale == pytest.approx(camera.depth_scale)


def test_open3ds_images_are_those_of_its_camera(run, tmp_path):
    model = through(run, RATIONAL)
    write_open3d(model, tmp_path)
    undistort = undistorter(model.recording.camera)
    assert sorted(path.name for path in (tmp_path / "color").iterdir()) == [f"{k:06d}.png" for k in run.kept]
    color = cv2.imread(str(model.recording.frames[1].color.path))[..., ::-1]
    depth_m = np.full(color.shape[:2], 1.5, np.float32)
    expected = undistort(Scan(np.ascontiguousarray(color), depth_m))
    assert np.array_equal(cv2.imread(str(tmp_path / "color" / "000001.png"))[..., ::-1], expected.color)
    stored = cv2.imread(str(tmp_path / "depth" / "000001.png"), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(stored, np.rint(5000 * expected.depth_m).astype(np.uint16))


def test_open3d_writes_no_images_for_a_pinhole(run, tmp_path):
    write_open3d(through(run, PINHOLE), tmp_path)
    assert not (tmp_path / "color").exists()


def test_nerfstudios_images_are_undistorted_for_the_rational_lens(run, tmp_path):
    path = write_nerfstudio(through(run, RATIONAL), tmp_path)[0]
    frame = json.loads(path.read_text())["frames"][1]
    assert frame["file_path"] == "images/000001.png" and (tmp_path / frame["depth_file_path"]).is_file()
    assert (tmp_path / "images" / "000001.png").is_file()


@pytest.mark.parametrize(
    ("lens", "name"),
    [
        (PINHOLE, "distortion_k1_k2_p1_p2_k3"),
        (LENSES[1], "distortion_k1_k2_p1_p2_k3"),
        (RATIONAL, "distortion_k1_k2_p1_p2_k3_k4_k5_k6"),
        (LENSES[3], "fisheye_k1_k2_k3_k4"),
    ],
    ids=str,
)
def test_numpy_names_the_lens(run, tmp_path, lens, name):
    with np.load(write_numpy(through(run, lens), tmp_path)[0]) as data:
        assert data[name].tolist() == list(lens.coefficients or (0.0,) * 5)


def test_nothing_is_shown_beyond_the_fold():
    """Of a lens that folds over outside of the image, ideal pixels from beyond the fold stay black."""
    camera = Camera(130, 130, 79.5, 59.5, 160, 120, lens=radial_tangential_lens(-0.25))
    assert camera.lens_fault() is None and camera.lens.limit[0] > 1
    wide = replace(camera, width=480, height=120, cx=239.5)
    white = Scan(np.full((120, 480, 3), 255, np.uint8), np.full((120, 480), 2, np.float32))
    seen = undistorter(wide)(white)
    far = np.abs(np.arange(480) - 239.5) > 130 * camera.lens.limit[0] + 1
    assert far.any() and not seen.color[:, far].any() and not seen.depth_m[:, far].any()
    assert seen.color[59, 239].all()
