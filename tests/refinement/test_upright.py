"""The vertical of the world from an accelerometer in a moving hand, whose axes are a little askew."""

from dataclasses import replace

import numpy as np
import pytest

from miniloop_cli.geometry import se3
from miniloop_cli.refinement.gravity import GRAVITY_M_S2, felt, upright
from miniloop_cli.refinement.inputs import Scans
from miniloop_cli.refinement.joint import level
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.priors import Accelerometer, Vertical

ASKEW = se3.exp_so3(np.radians([1.5, -2.0, 1.0]))
WORLD = se3.pose(se3.exp_so3(np.array([1.8, 0.3, -0.2])), np.array([3.0, -1.0, 2.0]))  # not level, as images leave it


def pose_at(t_s):
    """A hand-held camera in a level world: camera to world at times (n,) s; it accelerates by some m/s^2."""
    w = np.stack([0.4 * np.sin(1.1 * t_s) - 1.6, 0.5 * np.sin(0.8 * t_s + 1), 0.3 * np.sin(1.4 * t_s)], axis=1)
    c = np.stack([0.2 * np.sin(3.1 * t_s), 0.15 * np.sin(2.3 * t_s + 2), 0.1 * np.cos(2.7 * t_s)], axis=1)
    return se3.pose(se3.exp_so3(w), c)


def readings(rng, stamps_s, sign=1.0):
    """What an accelerometer at 200 Hz reads (m/s^2), with its noise."""
    t, h = np.arange(stamps_s[0] - 0.5, stamps_s[-1] + 0.5, 0.005), 1e-3
    T = pose_at(t)
    own = (pose_at(t + h)[:, :3, 3] - 2 * T[:, :3, 3] + pose_at(t - h)[:, :3, 3]) / h**2
    force = np.einsum("nji,nj->ni", T[:, :3, :3], own + np.array([0, 0, GRAVITY_M_S2])) @ ASKEW
    force = sign * force + rng.normal(0, 0.2, force.shape)
    mean = np.array([force[np.abs(t - s) < 0.15].mean(axis=0) for s in stamps_s])
    return Accelerometer(t, force, mean / np.linalg.norm(mean, axis=1)[:, None])


def tilt_deg(T_up_world):
    """How far z is from the true vertical once the world is turned."""
    return np.degrees(np.arccos((T_up_world @ WORLD)[2, 2]))


@pytest.mark.parametrize("rate_hz", [5, 30])
@pytest.mark.parametrize("sign", [1, -1], ids=["up", "down"])
def test_up_is_found_through_the_motion_of_the_hand(rng, rate_hz, sign):
    stamps_s = 100 + np.arange(0, 20, 1 / rate_hz)
    known = np.ones(len(stamps_s), bool)
    T = WORLD @ pose_at(stamps_s)
    found = upright(readings(rng, stamps_s, sign), T, stamps_s, known)
    assert tilt_deg(found.T_up_world) < 0.3
    up_true = pose_at(stamps_s)[:, 2, :3]
    off = np.degrees(np.arccos(np.clip((found.term.up_cam * up_true[found.term.frames[:, 0]]).sum(axis=1), -1, 1)))
    assert np.median(off) < 0.5
    # All frames together count for no more than the readings do: 20 s hold some 40 windows.
    assert found.term.sigma_rad / np.sqrt(len(stamps_s)) > np.radians(0.2) / np.sqrt(45)


def test_frames_too_far_apart_for_a_path_give_the_mean_direction(rng):
    stamps_s = 100 + np.arange(0, 40, 1.0)
    accelerometer = readings(rng, stamps_s)
    accelerometer.up[3] = np.nan
    known = np.arange(40) != 5
    force, own = felt(accelerometer, WORLD @ pose_at(stamps_s), stamps_s, known)
    assert not own.any()
    assert np.isnan(force[[3, 5]]).all()
    np.testing.assert_array_equal(np.delete(force, [3, 5], axis=0), np.delete(accelerometer.up, [3, 5], axis=0))
    found = upright(accelerometer, WORLD @ pose_at(stamps_s), stamps_s, known)
    assert tilt_deg(found.T_up_world) < 3  # of 38 directions that are 8 degrees off
    assert len(found.term.frames) == 38


def test_no_readings_no_vertical(rng):
    stamps_s = 100 + np.arange(0, 2, 0.1)
    accelerometer = readings(rng, stamps_s)
    accelerometer.up[:] = np.nan
    assert upright(accelerometer, pose_at(stamps_s), stamps_s, np.ones(20, bool)) is None


def test_poses_that_are_not_refined_are_laid_level_too(rng):
    stamps_s = 100 + np.arange(0, 20, 0.2)
    poses = Poses(WORLD @ pose_at(stamps_s), np.zeros(100, int))
    scans = Scans([], [], stamps_s, stamps_s, None, "rootsift")
    assert level(poses, scans) == (poses, [])
    scans = replace(scans, vertical=Vertical(readings(rng, stamps_s), 3.0))
    found, terms = level(poses, scans)
    off = np.degrees(np.arccos(np.clip((found.T_world_cam[:, 2, :3] * pose_at(stamps_s)[:, 2, :3]).sum(axis=1), -1, 1)))
    assert off.max() < 0.3
    assert len(terms) == 1
