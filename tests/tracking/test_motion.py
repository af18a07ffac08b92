"""The motion of a frame from points and depths: right, robust, honest, or none."""

import numpy as np
import pytest

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.partial_motion import PartialMotion
from miniloop_cli.scene.tracked import ENOUGH_POINTS
from miniloop_cli.tracking.motion import (
    DEPTH_SIGMA_FACTOR,
    MIN_HELPED,
    SIGMA_PX,
    Measured,
    frame_motion,
    normal_equations,
)

CAMERA = Camera(525.0, 520.0, 319.5, 239.5, 640, 480)
LENS = (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)


def cloud(rng, n):
    """n points (n, 3) that the key camera sees."""
    px = rng.uniform((0, 0), (639, 479), (n, 2))
    return CAMERA.backproject(px, rng.uniform(0.8, 4, n))


def random_pose(rng, rad=0.1, m=0.1):
    return se3.pose(se3.exp_so3(rng.uniform(-rad, rad, 3)), rng.uniform(-m, m, 3))


def measured(T_cam_key, p_key):
    p_cam = se3.transform(T_cam_key, p_key)
    return CAMERA.project(p_cam), p_cam[:, 2].copy()


def apart(T, other):
    """Degrees and metres."""
    off = T @ se3.inverse(other)
    return se3.rotation_angle_deg(off[:3, :3]), np.linalg.norm(off[:3, 3])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("with_depth", [0.0, 0.5, 1.0])
def test_the_motion_of_exact_measurements_is_exact(seed, with_depth):
    rng = np.random.default_rng(seed)
    p_key, T = cloud(rng, 80), random_pose(rng)
    px, z_m = measured(T, p_key)
    z_m[rng.random(80) >= with_depth] = np.nan
    motion = frame_motion(Measured(p_key, px, z_m), np.eye(4), CAMERA)
    assert np.abs(motion.T_cam_key - T).max() < 1e-6
    assert motion.agrees.all()


@pytest.mark.parametrize("seed", range(5))
def test_gross_outliers_do_not_move_it_and_do_not_agree(seed):
    rng = np.random.default_rng(seed)
    p_key, T = cloud(rng, 200), random_pose(rng, 0.05, 0.05)
    px, z_m = measured(T, p_key)
    wrong = np.arange(200) < 60
    angle = rng.uniform(0, 2 * np.pi, 60)
    px[wrong] += rng.uniform(40, 150, (60, 1)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    z_m[wrong] *= rng.uniform(0.5, 1.5, 60)
    motion = frame_motion(Measured(p_key, px, z_m), np.eye(4), CAMERA)
    assert np.array_equal(motion.agrees, ~wrong)
    # A Cauchy kernel never forgets an outlier altogether: one of r sigmas pulls like one of 4 / r.
    assert np.abs(motion.T_cam_key - T).max() < 1e-4


def test_there_is_none_of_too_few_points(rng):
    p_key = cloud(rng, ENOUGH_POINTS - 1)
    assert frame_motion(Measured(p_key, *measured(np.eye(4), p_key)), np.eye(4), CAMERA) is None
    p_key = cloud(rng, ENOUGH_POINTS)
    assert frame_motion(Measured(p_key, *measured(np.eye(4), p_key)), np.eye(4), CAMERA) is not None
    behind = p_key * [1, 1, -1]
    assert frame_motion(Measured(behind, *measured(np.eye(4), p_key)), np.eye(4), CAMERA) is None
    assert frame_motion(Measured(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0)), np.eye(4), CAMERA) is None


@pytest.mark.parametrize("seed", range(10))
def test_there_is_none_of_random_measurements(seed):
    rng = np.random.default_rng(seed)
    p_key = cloud(rng, 150)
    px = rng.uniform((0, 0), (639, 479), (150, 2))
    assert frame_motion(Measured(p_key, px, rng.uniform(0.8, 4, 150)), np.eye(4), CAMERA) is None


def test_normal_equations_are_those_of_numerical_derivatives(rng):
    n = 40
    p_key, T = cloud(rng, n), random_pose(rng)
    px, z_m = measured(random_pose(rng), p_key)
    z_m[::5] = np.nan
    sigma_z_m = CAMERA.noise.sigma_m(np.nan_to_num(z_m, nan=1.0))

    def residuals(step):
        p_cam = se3.transform(se3.pose(se3.exp_so3(step[:3]), step[3:]) @ T, p_key)
        r_z = np.where(np.isfinite(z_m), (p_cam[:, 2] - z_m) / sigma_z_m, 0.0)
        return np.column_stack([(CAMERA.project(p_cam) - px) / 1.5, r_z]).ravel()

    h = 1e-6
    J = np.stack([(residuals(h * e) - residuals(-h * e)) / (2 * h) for e in np.eye(6)], axis=1)
    r = residuals(np.zeros(6))
    H, g, size = normal_equations(p_key, px, z_m, sigma_z_m, T, LENS, 1.5, np.inf)
    assert np.allclose(H, J.T @ J, rtol=1e-5, atol=1e-6 * np.abs(H).max())
    assert np.allclose(g, J.T @ r, rtol=1e-5, atol=1e-6 * np.abs(g).max())
    assert np.allclose(size, np.linalg.norm(r.reshape(n, 3)[:, :2], axis=1))
    # The kernel weighs pixels together, and depth by itself.
    scale = 3.0
    w_px, w_z = 1 / (1 + (size / scale) ** 2), 1 / (1 + (r.reshape(n, 3)[:, 2] / scale) ** 2)
    w = np.column_stack([w_px, w_px, w_z]).ravel()
    H, g, _ = normal_equations(p_key, px, z_m, sigma_z_m, T, LENS, 1.5, scale)
    assert np.allclose(H, J.T @ (w[:, None] * J), rtol=1e-5, atol=1e-6 * np.abs(H).max())
    assert np.allclose(g, J.T @ (w * r), rtol=1e-5, atol=1e-6 * np.abs(g).max())


def wall_known(T, sigma_rad=1e-3, sigma_m=1e-3):
    """What a wall across the view tells: the distance to it, and two turns."""
    return PartialMotion(T, np.diag([sigma_rad**-2] * 2 + [0, 0, 0] + [sigma_m**-2]))


@pytest.mark.parametrize(("n", "helped"), [(100, False), (20, True)])
def test_the_information_is_that_of_many_trials(rng, n, helped):
    trials = 500
    p_key, T = cloud(rng, n), random_pose(rng, 0.03, 0.03)
    px, z_m = measured(T, p_key)
    sigma_z_m = DEPTH_SIGMA_FACTOR * CAMERA.noise.sigma_m(z_m)
    errors, information = np.zeros((trials, 6)), np.zeros((6, 6))
    for k in range(trials):
        noisy_px = px + SIGMA_PX * rng.standard_normal((n, 2))
        seen = Measured(p_key, noisy_px, z_m + sigma_z_m * rng.standard_normal(n))
        off = rng.standard_normal(6) * [1e-3, 1e-3, 0, 0, 0, 1e-3]
        known = wall_known(se3.pose(se3.exp_so3(off[:3]), off[3:]) @ T) if helped else None
        motion = frame_motion(seen, T, CAMERA, known)
        off = motion.T_cam_key @ se3.inverse(T)  # [exp(w) | v] T, to first order: the step at the origin of T's points
        errors[k] = [*se3.log_so3(off[:3, :3]), *off[:3, 3]]
        information += motion.information / trials
    ratios = np.linalg.eigvals(np.cov(errors.T) @ information).real
    assert ratios.min() > 0.5 and ratios.max() < 2


@pytest.mark.parametrize("seed", range(5))
def test_few_points_tell_what_a_wall_leaves_open(seed):
    rng = np.random.default_rng(seed)
    p_key, T = cloud(rng, MIN_HELPED), random_pose(rng, 0.03, 0.03)
    seen = Measured(p_key, *measured(T, p_key))
    assert frame_motion(seen, np.eye(4), CAMERA) is None
    motion = frame_motion(seen, np.eye(4), CAMERA, wall_known(T))
    assert max(apart(motion.T_cam_key, T)) < 1e-5 and motion.agrees.all()
    assert frame_motion(Measured(*(a[:-1] for a in seen)), np.eye(4), CAMERA, wall_known(T)) is None


def test_points_that_contradict_what_is_known_give_no_motion(rng):
    p_key, T = cloud(rng, 10), random_pose(rng, 0.03, 0.03)
    seen = Measured(p_key, *measured(T, p_key))
    nearer = se3.pose(np.eye(3), [0, 0, 0.3]) @ T
    assert frame_motion(seen, T, CAMERA, wall_known(T)) is not None
    assert frame_motion(seen, T, CAMERA, wall_known(nearer)) is None
