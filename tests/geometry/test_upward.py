"""Up is found from cameras that are held level, against their down where they do not turn, and z after gravity."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.upward import to_y_up, up_direction


def cameras_around(up, count=40, pitch_deg=30.0):
    """Cameras that turn about `up`, looking down by `pitch_deg`."""
    yaw = np.linspace(0, 2, count)
    turned = se3.exp_so3(yaw[:, None] * np.array([0, -1.0, 0])) @ se3.exp_so3(np.array([-np.radians(pitch_deg), 0, 0]))
    axis = np.cross([0, -1.0, 0], up)
    R = se3.exp_so3(axis / np.linalg.norm(axis) * np.arccos(-up[1]))
    return se3.pose(R @ turned, np.zeros((count, 3)))


@given(st.integers(0, 9999))
def test_up_is_found_from_level_cameras(seed):
    up = np.random.default_rng(seed).normal(size=3)
    up /= np.linalg.norm(up)
    np.testing.assert_allclose(up_direction(cameras_around(up)), up, atol=1e-6)


def test_up_without_turns_is_against_the_cameras_down():
    T = np.repeat(np.eye(4)[None], 5, axis=0)
    np.testing.assert_allclose(up_direction(T), [0, -1, 0])
    np.testing.assert_allclose(up_direction(T, leveled=True), [0, 0, 1])
    np.testing.assert_allclose(up_direction(T[:0]), [0, -1, 0])


@given(st.integers(0, 9999))
def test_a_world_is_turned_so_that_up_is_y_and_cameras_look_along_minus_z(seed):
    up = np.random.default_rng(seed).normal(size=3)
    up /= np.linalg.norm(up)
    T = cameras_around(up)
    turn = to_y_up(T)
    np.testing.assert_allclose(turn[:3, :3] @ turn[:3, :3].T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(turn[:3, :3] @ up, [0, 1, 0], atol=1e-6)
    ahead = turn[:3, :3] @ T[:, :3, 2].mean(axis=0)
    assert ahead[2] < 0 and abs(ahead[0]) < 1e-6
