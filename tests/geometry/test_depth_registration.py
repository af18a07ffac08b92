"""Depth of one camera on the pixels of another: exact on planes, against OpenCV, occlusions empty."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.geometry import fisheye, radial_tangential, se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.depth_registration import register_depth
from miniloop_cli.geometry.lens import PINHOLE, fisheye_lens, radial_tangential_lens
from miniloop_cli.geometry.lens_kernels import distort, lens_numbers

DEPTH = Camera(126.0, 126.5, 80.3, 71.7, 160, 144)
COLOR = Camera(155.0, 156.0, 160.2, 89.9, 320, 180)
T_COLOR_DEPTH = se3.pose(cv2.Rodrigues(np.array([0.05, 0.01, -0.02]))[0], np.array([-0.032, -0.002, 0.004]))
WIDE = se3.pose(T_COLOR_DEPTH[:3, :3], np.array([-0.15, -0.05, 0.004]))  # apart enough for a shadow
WALL = ((0.1, 0.2, 1.0), 2.5, None)
BOX = ((0.3, -0.1, 1.0), 1.2, (-0.3, 0.3, -0.25, 0.25))
LENSES = {
    "pinhole": (PINHOLE, PINHOLE),
    "radial-tangential": (radial_tangential_lens(0.1, -0.05, 0.001, -0.002), radial_tangential_lens(-0.2, 0.05, 0.001)),
    "rational": (radial_tangential_lens(0.5, -0.1, 0, 0, 0.02, 0.4, -0.05, 0.01), radial_tangential_lens(0.1, -0.1)),
    "fisheye": (fisheye_lens(-0.02, 0.003), fisheye_lens(-0.03, 0.001)),
}


def cast(camera: Camera, T_color_cam: np.ndarray, surfaces) -> np.ndarray:
    """(h, w) depth of planes n . p = d in the colour frame, some bounded in x and y: one ray for each pixel."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    ideal = camera.undistort(np.stack([u.ravel(), v.ravel()], axis=1))
    rays = np.column_stack([(ideal - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(ideal))])
    rays, origin = rays @ T_color_cam[:3, :3].T, T_color_cam[:3, 3]
    z = np.full(len(rays), np.inf)
    for normal, distance, bounds in surfaces:
        s = (distance - origin @ np.array(normal)) / (rays @ np.array(normal))
        p = origin + s[:, None] * rays
        hit = (s > 0) & (s < z)
        if bounds:
            hit &= (p[:, 0] > bounds[0]) & (p[:, 0] < bounds[1]) & (p[:, 1] > bounds[2]) & (p[:, 1] < bounds[3])
        z[hit] = s[hit]
    return np.where(np.isfinite(z), z, 0).reshape(camera.height, camera.width).astype(np.float32)


def with_lens(camera: Camera, lens) -> Camera:
    return Camera(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, lens=lens)


@pytest.mark.parametrize("name", LENSES)
def test_a_plane_is_where_the_other_camera_measures_it(name):
    depth, color = (with_lens(c, lens) for c, lens in zip((DEPTH, COLOR), LENSES[name], strict=True))
    found = register_depth(cast(depth, T_COLOR_DEPTH, [WALL]), depth, color, T_COLOR_DEPTH)
    truth = cast(color, np.eye(4), [WALL])
    seen = found > 0
    assert seen.mean() > 0.4  # all that the narrower view of the depth camera covers
    # Between the corners of a triangle a lens bends what is drawn straight: under a tenth of a millimetre here.
    assert np.abs(found - truth)[seen].max() < (1e-6 if name == "pinhole" else 1e-4)
    assert found.dtype == np.float32 and found.shape == (180, 320)


@pytest.mark.parametrize("name", LENSES)
def test_what_the_depth_camera_does_not_see_is_empty_and_nothing_is_made_up(name):
    depth, color = (with_lens(c, lens) for c, lens in zip((DEPTH, COLOR), LENSES[name], strict=True))
    found = register_depth(cast(depth, WIDE, [WALL, BOX]), depth, color, WIDE)
    truth = cast(color, np.eye(4), [WALL, BOX])
    wall, box = (cast(color, np.eye(4), [surface]) for surface in (WALL, BOX))
    seen = found > 0
    # Every depth is that of one of the two surfaces; none lies between them.
    error = np.minimum(np.abs(found - wall), np.where(box > 0, np.abs(found - box), np.inf))
    assert error[seen].max() < 1e-4
    # It is the nearer one but at the outline, where half a depth pixel is missing.
    inside = cv2.erode((truth < 2).astype(np.uint8), np.ones((7, 7)))[3:-3, 3:-3] > 0
    assert np.abs(found - truth)[3:-3, 3:-3][inside & seen[3:-3, 3:-3]].max() < 1e-4
    # The shadow: pixels that see the wall, while the box hides it from the depth camera.
    v, u = np.nonzero(truth > 2)
    p_color = color.backproject(color.undistort(np.stack([u, v], 1).astype(float)), truth[v, u].astype(float))
    p = se3.transform(se3.inverse(WIDE), p_color)
    px = depth.distort(depth.project(p))
    near = cast(depth, WIDE, [BOX])
    within = (px > 2).all(1) & (px < [depth.width - 3, depth.height - 3]).all(1)
    hidden = np.zeros(len(px), bool)
    rows = np.rint(px[within]).astype(int)
    shrunk = cv2.erode((near > 0).astype(np.uint8), np.ones((5, 5)))
    hidden[within] = shrunk[rows[:, 1], rows[:, 0]] > 0
    assert hidden.sum() > 50
    assert (found[v[hidden], u[hidden]] == 0).all()


def test_the_same_camera_changes_nothing():
    depth_m = cast(DEPTH, np.eye(4), [WALL])
    found = register_depth(depth_m, DEPTH, DEPTH, np.eye(4))
    np.testing.assert_allclose(found, depth_m, atol=1e-6)


@pytest.mark.skipif(not hasattr(cv2, "registerDepth"), reason="this OpenCV has no registerDepth")
def test_it_agrees_with_opencv():
    depth, color = DEPTH, with_lens(COLOR, radial_tangential_lens(0.1, -0.05, 0.001, -0.002))
    measured = cast(depth, T_COLOR_DEPTH, [WALL, BOX])
    ours = register_depth(measured, depth, color, T_COLOR_DEPTH)
    coefficients = np.array(color.lens.coefficients)
    theirs = cv2.registerDepth(depth.K, color.K, coefficients, T_COLOR_DEPTH, measured, (320, 180), True)
    both = (ours > 0) & (theirs > 0) & np.isfinite(theirs)
    assert both.mean() > 0.2
    difference = np.abs(ours - theirs)[both]
    # OpenCV's takes whole pixels, which on these slopes is up to some millimetres.
    assert np.median(difference) < 0.003 and (difference < 0.02).mean() > 0.97


def test_what_lies_behind_is_hidden_by_what_lies_before():
    depth_m = np.full((144, 160), 3.0, np.float32)
    depth_m[:, 40:80] = 1.0
    T = se3.pose(np.eye(3), np.array([0.3, 0.0, 0.0]))
    found = register_depth(depth_m, DEPTH, DEPTH, T)
    # The near strip moves by f 0.3 / 1 = 37.8 px, over the wall that moves by 12.6 px.
    assert (np.abs(found[20:-20, 80:115] - 1) < 1e-6).all()
    assert (np.abs(found[20:-20, 120:150] - 3) < 1e-6).all()


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_any_depth_gives_depth_between_its_extremes(seed):
    rng = np.random.default_rng(seed)
    depth_m = rng.uniform(0.3, 5.0, (24, 32)).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < rng.random()] = rng.choice([0.0, np.nan, np.inf, -1.0])
    depth_m = cv2.blur(depth_m, (3, 3)) if rng.random() < 0.5 else depth_m
    camera = Camera(30.0, 30.0, 15.5, 11.5, 32, 24)
    found = register_depth(depth_m, camera, camera, np.eye(4))
    assert np.isfinite(found).all()
    valid = depth_m[np.isfinite(depth_m) & (depth_m > 0)]
    assert (found == 0).all() or (found[found > 0].min() > valid.min() - 1e-5 and found.max() < valid.max() + 1e-5)


def test_depth_behind_the_other_camera_and_far_beside_it_is_left_out():
    depth_m = np.full((144, 160), 0.5, np.float32)
    behind = se3.pose(np.eye(3), np.array([0.0, 0.0, -0.6]))
    beside = se3.pose(np.eye(3), np.array([50.0, 0.0, 0.0]))
    assert not register_depth(depth_m, DEPTH, COLOR, behind).any()
    assert not register_depth(depth_m, DEPTH, COLOR, beside).any()


@pytest.mark.parametrize("name", ["radial-tangential", "rational", "fisheye"])
def test_the_lens_of_the_kernel_is_that_of_the_camera(name):
    lens = LENSES[name][1] if name != "rational" else LENSES[name][0]
    module = fisheye if name == "fisheye" else radial_tangential
    xy = np.random.default_rng(0).uniform(-3, 3, (500, 2))
    found = np.array([distort(x, y, *lens_numbers(lens)) for x, y in xy])
    np.testing.assert_allclose(found, module.distort(xy, lens.coefficients), rtol=1e-12, atol=1e-12)
