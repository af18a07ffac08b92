"""Undistorted pixels against the distortion model itself, inverted by a solver of another kind."""

import numpy as np
import pytest
from scipy.optimize import root

from miniloop_cli.datasets.intrinsics import freiburg_camera
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import radial_tangential_lens

STRONG = Camera(517.3, 516.5, 318.6, 255.3, 640, 480, lens=radial_tangential_lens(-0.28, 0.07, 1e-3, -2e-3, 0.01))


def measured(camera, px_ideal):
    """Where a lens of Brown and Conrady images what an ideal camera would image at pixels (n, 2)."""
    k1, k2, p1, p2, k3 = camera.lens.coefficients
    x, y = ((px_ideal - [camera.cx, camera.cy]) / [camera.fx, camera.fy]).T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent = [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y]
    return np.stack(bent, axis=1) * [camera.fx, camera.fy] + [camera.cx, camera.cy]


@pytest.mark.parametrize("camera", [freiburg_camera("1", ""), freiburg_camera("2", ""), STRONG], ids=["1", "2", "wide"])
def test_undistorted_pixels_solve_the_distortion_model(camera):
    u, v = np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 7))
    px = np.stack([u.ravel(), v.ravel()], axis=1)
    found = camera.undistort(px)
    np.testing.assert_allclose(measured(camera, found), px, atol=1e-9)
    expected = [root(lambda q, p=p: (measured(camera, q[None]) - p)[0], p, tol=1e-13).x for p in px]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_an_ideal_lens_and_no_pixels_stay_as_they_are():
    px = np.array([[1.5, 2.5], [600.0, 400.0]])
    assert np.array_equal(Camera(500, 500, 320, 240, 640, 480).undistort(px), px)
    assert STRONG.undistort(np.zeros((0, 2))).shape == (0, 2)


def test_whole_numbers_are_a_camera_as_well():
    """Kernels are compiled for floats: a camera of whole numbers once ended in a long error of the compiler."""
    camera = Camera(525, 525, 320, 240, 640, 480, 5000)
    assert {type(n) for n in (camera.fx, camera.fy, camera.cx, camera.cy, camera.depth_scale)} == {float}
    assert camera == Camera(525.0, 525.0, 320.0, 240.0, 640, 480, 5000.0)
