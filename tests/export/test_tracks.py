"""Tracks of the bundle adjustment in COLMAP's formats, masks, and nerfstudio's file read as it is documented."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from miniloop_cli.datasets import ImageFile, open_sequence
from miniloop_cli.errors import InputError
from miniloop_cli.export.colmap import write_colmap
from miniloop_cli.export.model import Model
from miniloop_cli.export.nerfstudio import write_nerfstudio
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.bundle import BundleSettings, bundle_adjust
from miniloop_cli.refinement.joint import landmarks_of
from miniloop_cli.refinement.timing import Measurements
from miniloop_cli.results.folder import Results
from miniloop_cli.results.landmarks import read_landmarks, write_landmarks
from miniloop_cli.scene.landmarks import Landmarks

POINTS = 60


@pytest.fixture
def tracked(run):
    """The run with landmarks that its cameras see, half a pixel off; some sightings lie outside of the images."""
    rng, camera = np.random.default_rng(5), run.model.sequence.camera
    points = np.concatenate([T[:3, 3] + T[:3, 2] * 2 + 0.5 * rng.normal(size=(POINTS, 3)) for T in run.T])
    found = []
    for row, T in enumerate(run.T):
        p_cam = se3.transform(se3.inverse(T), points)
        ahead = np.flatnonzero(p_cam[:, 2] > 0.3)
        px = camera.project(p_cam[ahead]) + rng.normal(scale=0.3, size=(len(ahead), 2))
        near = (np.abs(px - [80, 60]) < [100, 80]).all(axis=1)
        found += [(point, run.kept[row], *at) for point, at in zip(ahead[near], px[near], strict=True)]
    point, frame, u, v = np.array(sorted(found)).T
    landmarks = Landmarks(
        points, point.astype(np.int32), frame.astype(np.int32), np.stack([u, v], 1).astype(np.float32)
    )
    landmarks = landmarks.seen_at(np.ones(len(point), bool))
    write_landmarks(run.results / "landmarks.npz", landmarks)
    return Model(Results(run.results), open_sequence(run.sequence)), landmarks


def test_landmarks_are_read_back(tracked, run):
    read = read_landmarks(run.results / "landmarks.npz")
    for name in ("points_world", "point", "frame", "px"):
        np.testing.assert_array_equal(getattr(read, name), getattr(tracked[1], name))
    assert len(read_landmarks(run.results / "none.npz").point) == 0


@pytest.mark.parametrize("part", ["points", "point", "frame", "px_ideal", "bytes"])
def test_damaged_landmarks_are_one_line(tracked, run, part):
    path = run.results / "landmarks.npz"
    if part == "bytes":
        path.write_bytes(path.read_bytes()[:300])
    else:
        with np.load(path) as stored:
            arrays = dict(stored)
        arrays[part] = arrays[part][:-1] if part != "points" else arrays[part][:3]
        np.savez(path, **arrays)
    with pytest.raises(InputError, match=r"landmarks\.npz: .*register"):
        read_landmarks(path)


@pytest.mark.parametrize("form", ["sparse", "sparse/0"])
def test_colmap_sees_the_tracks(tracked, run, tmp_path, form):
    """Every point projects, by COLMAP's own camera, to within a pixel of where its images say that they see it."""
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel here")
    model, landmarks = tracked
    write_colmap(model, tmp_path)
    read = pycolmap.Reconstruction(str(tmp_path / form))
    inside = (landmarks.px > -0.5).all(axis=1) & (landmarks.px < [159.5, 119.5]).all(axis=1)
    expected = landmarks.seen_at(inside)
    assert not inside.all() and len(expected.point) > 200
    assert len(read.points3D) == len(expected.points_world)
    assert sum(point.track.length() for point in read.points3D.values()) == len(expected.point)
    sightings = 0
    for image in read.images.values():
        frame = image.image_id - 1
        assert image.name == f"{frame:06d}.png"
        for seen in image.points2D:
            point = read.points3D[seen.point3D_id]
            off = read.cameras[image.camera_id].img_from_cam(image.cam_from_world() * point.xyz) - seen.xy
            assert np.linalg.norm(off) < 2
            row = np.flatnonzero((expected.point == seen.point3D_id - 1) & (expected.frame == frame))
            np.testing.assert_allclose(seen.xy - 0.5, expected.px[row[0]], atol=1e-3)
            np.testing.assert_allclose(point.xyz, expected.points_world[seen.point3D_id - 1], rtol=1e-6)
            sightings += 1
    assert sightings == len(expected.point)
    before = {k: point.error for k, point in read.points3D.items()}
    read.update_point_3d_errors()
    for k, point in read.points3D.items():
        assert before[k] == pytest.approx(point.error, abs=2e-3)


def test_both_forms_say_the_same(tracked, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel here")
    write_colmap(tracked[0], tmp_path)
    text, binary = (pycolmap.Reconstruction(str(tmp_path / form)) for form in ("sparse", "sparse/0"))
    for k, point in text.points3D.items():
        assert tuple(point.color) == tuple(binary.points3D[k].color)
        assert [(e.image_id, e.point2D_idx) for e in point.track.elements] == [
            (e.image_id, e.point2D_idx) for e in binary.points3D[k].track.elements
        ]


def test_points_have_the_colors_of_their_images(tracked, run, tmp_path):
    """Each image a colour of its own: a point is as bright as the mean of those that see it."""
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel here")
    for k, path in enumerate(sorted((run.sequence / "rgb").iterdir())):
        cv2.imwrite(str(path), np.full((120, 160, 3), 20 * k, np.uint8))
    write_colmap(Model(Results(run.results), open_sequence(run.sequence)), tmp_path)
    off = []
    for point in pycolmap.Reconstruction(str(tmp_path / "sparse")).points3D.values():
        mean = np.mean([20 * (element.image_id - 1) for element in point.track.elements])
        off.append(np.abs(point.color - mean).max())
    assert np.mean(np.array(off) <= 1) > 0.8  # a sighting at the rim of an undistorted image may be black


def test_a_landmark_is_what_the_adjustment_agrees_with():
    """Sightings far off are left out, with points that hardly anything is left of; pixels stay as measured."""
    rng = np.random.default_rng(6)
    points = rng.uniform([-1, -1, 2], [1, 1, 4], (30, 3))
    camera = Camera(500, 500, 320, 240, 640, 480)
    T = se3.pose(se3.exp_so3(0.05 * rng.normal(size=(5, 3))), 0.2 * rng.normal(size=(5, 3)))
    track, frame = (grid.ravel() for grid in np.meshgrid(np.arange(30), np.arange(5), indexing="ij"))
    p_cam = np.einsum("kij,kj->ki", se3.inverse(T)[frame][:, :3, :3], points[track]) + se3.inverse(T)[frame][:, :3, 3]
    px, z = camera.project(p_cam), p_cam[:, 2]
    px[3] += 40  # point 0 in frame 3
    px[5:9] += rng.normal(scale=60, size=(4, 2))  # point 1, everywhere but in the last frame
    settings = BundleSettings(sigma_px=0.25, scale_px=3.0)
    result = bundle_adjust(T, frame, track, px, z, camera, settings)
    zero = np.zeros(len(frame))
    measured = Measurements(frame, track, zero, px, z, np.zeros((len(frame), 2)), zero)
    found = landmarks_of(result, measured)
    assert 3 not in found.frame[found.point == 0].tolist()
    np.testing.assert_allclose(found.points_world[0], points[0], atol=0.02)
    assert (np.diff(found.point) >= 0).all() and np.bincount(found.point).min() >= 2
    assert len(found.point) >= (track > 1).sum()
    np.testing.assert_allclose(found.px[-5:], px[-5:], atol=1e-4)


def masked(run):
    """The recording with a mask: the left half of frame 4 is to be ignored."""
    path = run.sequence / "mask.png"
    image = np.zeros((120, 160), np.uint8)
    image[:, :80] = 255
    cv2.imwrite(str(path), image)
    sequence = run.model.sequence
    frames = list(sequence.frames)
    frames[4] = replace(frames[4], mask=ImageFile(path))
    return Model(Results(run.results), replace(sequence, frames=tuple(frames)))


def test_colmap_masks(run, tmp_path):
    write_colmap(masked(run), tmp_path)
    names = sorted(path.name for path in (tmp_path / "masks").iterdir()) if (tmp_path / "masks").exists() else []
    assert "000004.png.png" in names
    mask = cv2.imread(str(tmp_path / "masks" / "000004.png.png"), cv2.IMREAD_UNCHANGED)
    assert (mask[20:100, 20:70] == 0).all() and (mask[20:100, 90:140] == 255).all()


def read_nerfstudio(path):
    """Frames of a transforms.json as its documentation has it: (c2w OpenGL, K, colour, depth in m, mask or None)."""
    data = json.loads(path.read_text())
    assert data["camera_model"] in ("OPENCV", "OPENCV_FISHEYE")
    K = np.array([[data["fl_x"], 0, data["cx"]], [0, data["fl_y"], data["cy"]], [0, 0, 1]])
    with_mask = ["mask_path" in frame for frame in data["frames"]]
    assert all(with_mask) or not any(with_mask)  # its parser demands it
    frames = []
    for frame in data["frames"]:
        c2w = np.array(frame["transform_matrix"])
        assert c2w.shape == (4, 4) and np.allclose(c2w[:3, :3] @ c2w[:3, :3].T, np.eye(3), atol=1e-6)
        color = cv2.imread(str(path.parent / frame["file_path"]))
        depth = cv2.imread(str(path.parent / frame["depth_file_path"]), cv2.IMREAD_UNCHANGED)
        assert color.shape == (data["h"], data["w"], 3) and depth.shape == color.shape[:2]
        mask = None
        if "mask_path" in frame:
            mask = cv2.imread(str(path.parent / frame["mask_path"]), cv2.IMREAD_UNCHANGED)
            assert mask.shape == depth.shape and set(np.unique(mask)) <= {0, 255}
            mask = mask > 0  # True: used
        frames.append((c2w, K, color, depth * data["depth_unit_scale_factor"], mask))
    return frames


def test_nerfstudio_masks_and_depth(run, tmp_path):
    frames = read_nerfstudio(write_nerfstudio(masked(run), tmp_path / "out")[0])
    assert len(frames) == len(run.kept)
    for number, (c2w, _, _, depth, mask) in zip(run.kept, frames, strict=True):
        np.testing.assert_allclose(c2w[:3, 3], run.T[list(run.kept).index(number)][:3, 3], atol=1e-6)
        ignored = number == 4
        assert (mask[:, :80] == (not ignored)).all() and mask[:, 80:].all()
        np.testing.assert_allclose(depth[mask], 1.5, atol=1e-3)


def test_nerfstudio_without_masks_names_none(run, tmp_path):
    frames = read_nerfstudio(write_nerfstudio(run.model, tmp_path / "out")[0])
    assert all(mask is None for *_, mask in frames)
    assert not (tmp_path / "out" / "masks").exists()
