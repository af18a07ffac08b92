"""Two views laid over each other: the same surface, another one, and the two sides of a wall."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from miniloop_cli.features.thumbnail import COLUMNS
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.verification.photometric import compare_views

CAMERA = Camera(525.0, 525.0, 319.5, 239.5, 640, 480)
ROWS = COLUMNS * 3 // 4
NEAR_M, THICK_M = 2.0, 0.08
TEXEL_M = 0.05


def texture(seed):
    waves = gaussian_filter(np.random.default_rng(seed).standard_normal((200, 200)), 2)
    return 128 + 40 * waves / waves.std()


def view(T_world_cam, wall_m, image):
    """What a camera sees of the plane z = wall_m."""
    scale = COLUMNS / CAMERA.width
    y, x = np.mgrid[0:ROWS, 0:COLUMNS] + 0.5
    fx, cx, cy = CAMERA.fx * scale, (CAMERA.cx + 0.5) * scale, (CAMERA.cy + 0.5) * scale
    rays = np.stack([(x - cx) / fx, (y - cy) / fx, np.ones_like(x)], axis=-1) @ T_world_cam[:3, :3].T
    z = (wall_m - T_world_cam[2, 3]) / rays[..., 2]
    p = T_world_cam[:3, 3] + rays * z[..., None]
    gray = map_coordinates(image, [p[..., 1] / TEXEL_M + 100, p[..., 0] / TEXEL_M + 100], order=1)
    z = z.astype(np.float32)
    return View(gray.astype(np.float32), z, z, z)


def pose(x_m=0.0, z_m=0.0, turn_deg=0.0):
    T = np.eye(4)
    T[:3, :3] = se3.exp_so3(np.radians([0.0, turn_deg, 0.0]))
    T[:3, 3] = x_m, 0.0, z_m
    return T


def votes(T_a, view_a, T_b, view_b):
    return compare_views([(view_a, view_b)], (se3.inverse(T_b) @ T_a)[None], CAMERA)[0]


@pytest.mark.parametrize("turn_deg", [-20, 0, 25])
def test_the_same_wall_speaks_for_and_another_against(turn_deg):
    a, b = pose(), pose(0.3, 0.2, turn_deg)
    same = votes(a, view(a, NEAR_M, texture(0)), b, view(b, NEAR_M, texture(0)))
    other = votes(a, view(a, NEAR_M, texture(0)), b, view(b, NEAR_M, texture(1)))
    assert same[0] > 1000 and same[1] < 0.02 * same[0]
    assert other[1] > 1000 and other[0] < 0.6 * other[1]


@pytest.mark.parametrize("turn_deg", [150, 180, 205])
def test_the_two_sides_of_a_wall_say_nothing_of_each_other(turn_deg):
    """Rooms on both sides of a thin wall: their pictures differ, and the poses are right."""
    a, b = pose(), pose(0.1, 2 * NEAR_M + THICK_M, turn_deg)
    there = view(b, NEAR_M + THICK_M, texture(1))
    assert (there.z_m > 0).all()
    assert votes(a, view(a, NEAR_M, texture(0)), b, there) == (0, 0)
