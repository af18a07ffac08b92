"""Poses of single images: known answers, outliers, honest covariances, with poselib and without."""

import sys

import numpy as np
import pytest
from map_scenes import CAMERA, sightings, some_pose

from miniloop_cli.geometry import se3
from miniloop_cli.mapping.absolute_pose import Sightings, refined_pose, robust_pose

NONE = Sightings(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))


def off(T, truth):
    E = se3.inverse(truth) @ T
    return np.linalg.norm(E[:3, 3]), float(se3.rotation_angle_deg(E[:3, :3]))


@pytest.fixture(params=["poselib", "opencv"])
def solver(request, monkeypatch):
    """With the wheel, and where it is missing."""
    if request.param == "opencv":
        monkeypatch.setitem(sys.modules, "poselib", None)
    else:
        pytest.importorskip("poselib")


@pytest.mark.usefixtures("solver")
def test_a_pose_is_found_among_wrong_matches(rng):
    truth = some_pose(rng)
    seen = sightings(rng, truth, sigma_px=0.5, sigma_m=0.002)
    wrong = rng.random(150) < 0.6
    px = np.where(wrong[:, None], rng.uniform(0, [640, 480], (150, 2)), seen.px_ideal)
    found = robust_pose(Sightings(px, seen.z_m, seen.points_m, seen.covariances_m2), CAMERA, 8.0)
    assert found is not None
    assert off(found[0], truth) < (0.05, 1.0)
    assert found[1][~wrong].mean() > 0.95
    assert found[1][wrong].mean() < 0.05


@pytest.mark.usefixtures("solver")
def test_nothing_is_made_of_nothing(rng):
    assert robust_pose(NONE, CAMERA, 8.0) is None
    truth = some_pose(rng)
    seen = sightings(rng, truth, 40)
    noise = Sightings(rng.uniform(0, [640, 480], (40, 2)), seen.z_m, seen.points_m, seen.covariances_m2)
    found = robust_pose(noise, CAMERA, 4.0)
    assert found is None or found[1].sum() < 12


def test_exact_sightings_give_the_exact_pose(rng):
    truth = some_pose(rng)
    seen = sightings(rng, truth, sigma_px=0.0, sigma_m=0.0)
    fit = refined_pose(truth @ some_pose(rng, 0.05, 0.05), seen, CAMERA)
    assert off(fit.T_world_cam, truth) < (1e-6, 1e-4)
    assert fit.inliers.all()


def test_a_wrong_focal_length_is_estimated_with_the_pose(rng):
    truth = some_pose(rng)
    seen = sightings(rng, truth, sigma_px=0.3, sigma_m=0.001)
    wide = Sightings(
        (seen.px_ideal - [CAMERA.cx, CAMERA.cy]) * 1.12 + [CAMERA.cx, CAMERA.cy],
        seen.z_m, seen.points_m, seen.covariances_m2,
    )  # fmt: skip
    fit = refined_pose(truth @ some_pose(rng, 0.02, 0.02), wide, CAMERA, with_focal=True)
    assert abs(fit.focal - 1.12) < 0.01
    assert off(fit.T_world_cam, truth) < (0.02, 0.2)


@pytest.mark.parametrize("with_depth", [False, True])
def test_covariances_promise_what_errors_are(with_depth):
    errors = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        truth = some_pose(rng)
        fit = refined_pose(truth, sightings(rng, truth, with_depth=with_depth), CAMERA)
        E = se3.inverse(fit.T_world_cam) @ truth
        xi = np.concatenate([se3.log_so3(E[:3, :3]), E[:3, 3]])
        errors.append(xi @ np.linalg.solve(fit.covariance, xi))
    # Chi-squared of 6 degrees of freedom has its mean at 6; the jackknife is a little cautious.
    assert 2.5 < np.mean(errors) < 8


def test_depth_tells_what_pixels_alone_leave_open():
    sigma = []
    for with_depth in (False, True):
        rng = np.random.default_rng(0)
        truth = some_pose(rng)
        fit = refined_pose(truth, sightings(rng, truth, 40, 2.0, 0.001, with_depth), CAMERA)
        sigma.append(np.trace(fit.covariance[3:, 3:]))
    assert sigma[1] < sigma[0]
