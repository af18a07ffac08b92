"""The camera from a recording's own points: right within its promises, and left alone where they do not tell it."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.experiments.known_cameras import (
    GUESSED,
    MIDDLE_M,
    ROUGH,
    calibrated,
    cloud,
    drawn,
    recording,
    true_theta,
    walk,
)
from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.geometry.camera_parameters import NAMES, OF_ONE_CAMERA, CameraParameters, numbers
from miniloop_cli.geometry.depth_model import rho
from miniloop_cli.geometry.lens import fisheye_lens, radial_tangential_lens
from miniloop_cli.refinement.camera_measurements import CameraMeasurements, free_bundle
from miniloop_cli.refinement.camera_priors import prior_sigmas
from miniloop_cli.refinement.camera_problem import CameraProblem
from miniloop_cli.refinement.joint import SHARP
from miniloop_cli.refinement.rolling_shutter import NO_TIMING, MovingCamera
from miniloop_cli.refinement.self_calibration import recalibrated, self_calibrate
from miniloop_cli.scene.calibration import Status

NONE = CameraParameters(GUESSED, np.zeros(len(NAMES)), MIDDLE_M)
THETA = np.array([0.02, -0.003, 4.0, -7.0, 0.1, -0.2, 0.001, -0.002, 0.1, 0.004, -0.006, 0.01, 0.003, *[0.0] * 8])


def case(seed, frames=12, points=700, truth=None, given=GUESSED, turning_only=False, plane=False):
    rng = np.random.default_rng(seed)
    T, X = walk(rng, frames, turning_only), cloud(rng, points, plane)
    truth = truth or drawn(rng, given)
    return T, recording(T, X, given, truth, rng), truth, rng


@pytest.mark.parametrize(
    "lens",
    [radial_tangential_lens(0.1, -0.2, 0.001, -0.002, 0.05), fisheye_lens(0.01, -0.02), radial_tangential_lens()],
)
def test_pixels_are_those_of_the_camera_and_derivatives_those_of_pixels(lens):
    given = replace(GUESSED, lens=lens)
    theta = THETA if lens.model != "fisheye" else np.where(np.arange(len(NAMES)) < 4, THETA, 0.0)
    p = np.array([[-0.7, 0.1, 0.6, 0.0], [0.5, -0.3, 0.2, 0.0], [1.5, 1.0, 2.5, 1.0]])
    at = CameraParameters(given, theta, MIDDLE_M)
    found = at.project(p)
    np.testing.assert_allclose(found.px.T, at.camera.distort(at.camera.project(p.T)), atol=1e-9)
    for axis in range(3):
        step = np.zeros((3, 1))
        step[axis] = 1e-6
        slope = (at.project(p + step).px - at.project(p - step).px) / 2e-6
        np.testing.assert_allclose(found.by_point[:, axis], slope, rtol=1e-4, atol=1e-3)
    for k in range(4 if lens.model == "fisheye" else 9):
        step = np.where(np.arange(len(NAMES)) == k, 1e-6, 0.0)
        ends = [CameraParameters(given, theta + sign * step, MIDDLE_M).project(p).px for sign in (1, -1)]
        np.testing.assert_allclose(found.by_parameters[:, k], (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-4)


def test_gradient_by_the_parameters_is_that_of_the_cost():
    T, measured, truth, _ = case(1, frames=5, points=150)
    seen = CameraMeasurements.of(
        measured.frame, measured.track, GUESSED.distort(measured.px_ideal), measured.z_m, (640, 480)
    )
    free = np.arange(OF_ONE_CAMERA)
    start = replace(NONE, theta=0.7 * truth.theta)
    bundle, terms, _ = free_bundle(T, seen, start, ROUGH, 1)
    problem = CameraProblem(bundle, terms, start, free, prior_sigmas(GUESSED)[free])
    p_cam = bundle.state.seen.p_cam

    def cost(theta):
        total = 0.0
        for term in terms:
            s = (term.at(replace(NONE, theta=theta)).linearise(p_cam)[0] ** 2).sum(axis=0)
            total += 0.5 * term.robust.cost(s[np.isfinite(s)]).sum()
        return total

    from miniloop_cli.refinement.camera_border import parameter_equations

    gradient = parameter_equations(terms, free, p_cam).gradient.sum(axis=0)
    for k in free:
        step = np.where(np.arange(len(NAMES)) == k, 1e-5 * prior_sigmas(GUESSED)[k], 0.0)
        slope = (cost(start.theta + step) - cost(start.theta - step)) / (2 * step[k])
        assert gradient[k] == pytest.approx(slope, rel=1e-3, abs=1e-3 * abs(gradient).min())
    before, after = problem.propose(1e-6)
    assert after < 0.5 * before


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_every_parameter_is_found_within_what_is_promised(seed):
    T, measured, truth, rng = case(seed, frames=16, points=1200)
    found = calibrated(measured, T, GUESSED, rng)
    told = found.status == Status.ESTIMATED
    error = (found.theta - true_theta(truth, found.middle_m))[told] / found.sigmas[told]
    assert told.sum() >= 11 and (np.abs(error) < 3).mean() >= 0.9 and np.abs(error).max() < 5
    assert found.gain > 0.3
    # What is promised is worth something: a tenth of what was known before.
    assert np.median(found.sigmas[told] / prior_sigmas(GUESSED)[told]) < 0.1


@pytest.mark.slow
def test_measurements_of_the_calibrated_camera_are_those_of_the_true_one():
    T, measured, truth, rng = case(3)
    found = calibrated(measured, T, GUESSED, rng)
    again = recalibrated(measured, found)
    px = GUESSED.distort(measured.px_ideal)
    rays = (again.px_ideal - [found.camera.cx, found.camera.cy]) / [found.camera.fx, found.camera.fy]
    true = truth.camera
    true_rays = (true.undistort(px) - [true.cx, true.cy]) / [true.fx, true.fy]
    assert np.abs(rays - true_rays).max() * true.fx < 0.6  # px, in the corners
    z_true = measured.z_m + truth.depth_step(measured.z_m, rho(px, 640, 480))
    ratio = again.z_m / z_true
    assert np.ptp(ratio) < 0.01  # one common factor is nobody's to know


@pytest.mark.slow
def test_what_a_turning_camera_does_not_tell_stays():
    T, measured, _, rng = case(5, turning_only=True)
    found = calibrated(measured, T, GUESSED, rng)
    kept = numbers("offset_m", "bend_per_m")
    assert (found.status[kept] == Status.UNOBSERVABLE).all() and not found.theta[kept].any()
    np.testing.assert_array_equal(found.sigmas[kept], prior_sigmas(GUESSED)[kept])
    assert found.camera.depth_model.offset_m == 0
    assert (found.status[numbers("focal", "cx", "cy", "k1")] == Status.ESTIMATED).all()


def test_a_camera_that_rests_tells_nothing():
    rng = np.random.default_rng(6)
    T = np.tile(np.eye(4), (12, 1, 1))
    measured = recording(T, cloud(rng, 400), GUESSED, drawn(rng, GUESSED), rng)
    found = calibrated(measured, T, GUESSED, rng)
    assert not found.changed and not found.theta.any() and found.camera.fx == GUESSED.fx


@pytest.mark.slow
@pytest.mark.parametrize("trust", [Trust.GUESS, Trust.CALIBRATED])
def test_a_right_camera_stays_right(trust):
    given = replace(GUESSED, trust=trust)
    T, measured, _, rng = case(7, truth=replace(NONE, given=given), given=given)
    found = calibrated(measured, T, given, rng)
    assert abs(found.camera.fx / given.fx - 1) < 0.002 and abs(found.camera.cx - given.cx) < 1


def test_few_points_are_not_asked():
    T, measured, _, _ = case(8, frames=4, points=60)
    moving = MovingCamera(GUESSED, np.arange(4.0) * 10, np.ones(4, bool))
    assert self_calibrate(T, measured, moving, NO_TIMING, ROUGH, SHARP, 1) is None


def test_a_depth_image_is_corrected_as_single_readings_are():
    camera = CameraParameters(Camera(525, 525, 31.5, 23.5, 64, 48), THETA, MIDDLE_M).camera
    rng = np.random.default_rng(9)
    depth_m = rng.uniform(0.5, 4, (48, 64)).astype(np.float32)
    depth_m[::7, ::5] = 0
    found = camera.depth_model.of_image(depth_m)
    v, u = np.nonzero(depth_m)
    single = camera.depth_model.corrected(depth_m[v, u].astype(float), rho(np.stack([u, v], 1).astype(float), 64, 48))
    np.testing.assert_allclose(found[v, u], single, rtol=1e-6)
    assert not found[depth_m == 0].any() and np.abs(found - depth_m).max() > 0.005
    corner, centre = rho(np.array([[0.0, 0.0], [31.5, 23.5]]), 64, 48)
    assert (corner, centre) == (1.0, 0.0)
