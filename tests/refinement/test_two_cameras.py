"""Depth of a camera of its own: what is read where, how that depends on where it stands, and that it is found."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.experiments import known_two_cameras
from benchmarks.experiments.known_two_cameras import OWN, Room, calibrated, drawn, room
from miniloop_cli.config import Depth
from miniloop_cli.features.keypoints3d import depth_at
from miniloop_cli.features.ray_depth import depth_at_point, depth_on_rays
from miniloop_cli.geometry import depth_camera_parameters as of_two
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.geometry.camera_parameters import NAMES, OF_ONE_CAMERA, CameraParameters
from miniloop_cli.geometry.depth_registration import register_depth
from miniloop_cli.geometry.lens import radial_tangential_lens
from miniloop_cli.refinement.birge_ratio import birge_ratio
from miniloop_cli.refinement.camera_priors import prior_sigmas
from miniloop_cli.refinement.two_cameras import TwoCameras
from miniloop_cli.scene.calibration import Calibration, Status
from miniloop_cli.scene.sequence import DepthCamera

COLOR = Camera(520.0, 522.0, 318.0, 243.0, 640, 480, trust=Trust.GUESS)
STEP = np.array([0.03, 4.0, -6.0, 0.01, -0.007, 0.004, -0.025, 0.01])


def slanted(own: Camera, T_color_depth, normal, distance):
    """Depth image of the plane normal . x = distance in the frame of colour, and depth along rays of colour."""
    v, u = np.mgrid[0 : own.height, 0 : own.width]
    rays = own.backproject(np.stack([u.ravel(), v.ravel()], 1).astype(float), np.ones(u.size))
    R, t = T_color_depth[:3, :3], T_color_depth[:3, 3]
    z = (distance - normal @ t) / (rays @ R.T @ normal)
    return z.reshape(own.height, own.width).astype(np.float32)


@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], [0.35, -0.2, 0.9], [-0.1, 0.4, 0.9]])
def test_depth_on_rays_is_where_they_meet_the_plane_and_what_registering_gives(normal):
    normal = np.array(normal) / np.linalg.norm(normal)
    own, T = of_two.moved(OWN.camera, np.eye(4), STEP)
    depth_m = slanted(own, T, normal, 1.8)
    px = np.random.default_rng(1).uniform([40, 40], [600, 440], (400, 2))
    z_m, slope = depth_on_rays(depth_m, px, COLOR, DepthCamera(own, tuple(T.ravel())), Depth())
    true_m = 1.8 / (COLOR.backproject(px, np.ones(400)) @ normal)
    told = np.isfinite(z_m)
    assert told.mean() > 0.9
    np.testing.assert_allclose(z_m[told], true_m[told], rtol=1e-5)
    right = np.array([1.0, 0.0])
    ahead, behind = (1.8 / (COLOR.backproject(px + step, np.ones(400)) @ normal) for step in (right, -right))
    inside = told & (slope[:, 0] != 0)  # at the end of the image there is none
    assert inside.mean() > 0.9 or normal[0] == 0
    np.testing.assert_allclose(slope[inside, 0], (ahead - behind)[inside] / 2, atol=2e-5)
    registered = register_depth(depth_m, own, COLOR, T)
    x, y = np.rint(px).astype(int).T
    at_pixel, _ = depth_on_rays(
        depth_m, np.stack([x, y], 1).astype(float), COLOR, DepthCamera(own, tuple(T.ravel())), Depth()
    )
    both = np.isfinite(at_pixel) & (registered[y, x] > 0)
    assert both.mean() > 0.9
    np.testing.assert_allclose(at_pixel[both], registered[y, x][both], rtol=1e-4)


def test_nothing_is_read_beside_an_edge_or_in_a_hole():
    depth_m = np.full((480, 640), 2.0, np.float32)
    depth_m[:, 300:400] = 1.0
    depth_m[200:220] = 0.0
    same = DepthCamera(replace(COLOR), tuple(np.eye(4).ravel()))
    px = np.array([[100.0, 100.0], [350.0, 100.0], [299.5, 100.0], [350.0, 210.0], [639.5, 100.0]])
    z_m, slope = depth_on_rays(depth_m, px, COLOR, same, Depth())
    np.testing.assert_allclose(z_m, [2.0, 1.0, np.nan, np.nan, np.nan])
    assert not slope[:2].any()


def test_one_reading_is_that_of_many():
    rng = np.random.default_rng(4)
    depth_m = np.kron(rng.choice([0.1, 1.0, 1.02, 1.5, 0.0, 9.0, np.nan, np.inf], (12, 16)), np.ones((4, 4)))
    depth_m = depth_m.astype(np.float32) * rng.uniform(0.99, 1.01, depth_m.shape).astype(np.float32)
    px = np.concatenate([rng.uniform(-2, [65, 49], (5000, 2)), rng.integers(0, [64, 48], (500, 2)).astype(float)])
    settings = Depth()
    limits = np.array([settings.min_m, settings.max_m, settings.edge_ratio])
    found = np.array([depth_at_point(depth_m, u, v, limits) for u, v in px])
    many = depth_at(depth_m, px, settings)
    assert np.isfinite(many).sum() > 1000
    assert np.isnan(many).sum() > 1000
    np.testing.assert_allclose(found, many, rtol=1e-12)


def test_the_lens_of_the_depth_camera_bends_what_is_read():
    lens = radial_tangential_lens(0.1, -0.2, 0.001, -0.002, 0.05)
    own = replace(OWN.camera, lens=lens)
    u, v = np.meshgrid(np.arange(own.width, dtype=float), np.arange(own.height, dtype=float))
    rays = own.backproject(own.undistort(np.stack([u.ravel(), v.ravel()], 1)), np.ones(u.size))
    normal = np.array([0.3, -0.2, 0.9])
    depth_m = (1.8 / (rays @ normal)).reshape(own.height, own.width).astype(np.float32)
    px = np.random.default_rng(5).uniform([80, 80], [560, 400], (300, 2))
    z_m, _ = depth_on_rays(depth_m, px, COLOR, DepthCamera(own, tuple(np.eye(4).ravel())), Depth())
    true_m = 1.8 / (COLOR.backproject(px, np.ones(300)) @ normal)
    told = np.isfinite(z_m)
    assert told.mean() > 0.9
    np.testing.assert_allclose(z_m[told], true_m[told], rtol=2e-5)


def test_readings_move_as_is_said():
    normal = np.array([0.3, -0.25, 0.9])
    normal /= np.linalg.norm(normal)
    given = DepthCamera(OWN.camera, tuple(se3.pose(np.eye(3), np.array([-0.02, 0.0, 0.0])).ravel()))
    depth_m = slanted(given.camera, given.T_color_depth, normal, 2.0)
    px = np.random.default_rng(2).uniform([80, 80], [560, 400], (300, 2))
    frame = np.zeros(300, int)
    two = TwoCameras(given, lambda color, own, _, px: depth_on_rays(depth_m, px, color, own, Depth()))
    start = CameraParameters(COLOR, np.zeros(len(NAMES)), 2.0)
    z_m, _, change = two.readings(start, frame, px)
    sigma = prior_sigmas(COLOR, given.camera)
    for k, name in enumerate(NAMES):
        if not change.by_theta[k].any():
            assert name in ("offset_m", "bend_per_m", "radial", "radial_bend_per_m")
            continue
        h = 0.02 * sigma[k]
        ends = [
            two.readings(replace(start, theta=np.where(np.arange(len(NAMES)) == k, sign * h, 0.0)), frame, px)[0]
            for sign in (1, -1)
        ]
        found = (ends[0] - ends[1]) / (2 * h)
        told = np.isfinite(found) & np.isfinite(z_m)
        assert told.mean() > 0.9
        scale = np.abs(found[told]).max()
        np.testing.assert_allclose(change.by_theta[k, told], found[told], atol=0.03 * scale + 1e-4, err_msg=name)


def test_what_is_estimated_is_a_depth_camera():
    theta = np.zeros(len(NAMES))
    theta[OF_ONE_CAMERA:] = STEP
    status = np.where(np.arange(len(NAMES)) >= OF_ONE_CAMERA, int(Status.ESTIMATED), int(Status.NO_GAIN))
    found = Calibration(COLOR, theta, np.diag(prior_sigmas(COLOR, OWN.camera) ** 2), status, 2.0, 0.5, 0.1, 0.02, OWN)
    expected = OWN.moved(STEP)
    assert found.depth_camera.pose_rows == expected.pose_rows and found.depth_camera.camera.fx == expected.camera.fx
    assert found.depth_camera.camera.trust == Trust.CALIBRATED
    values = {each.name: each for each in found.values()}
    assert values["depth_fx"].value == pytest.approx(OWN.camera.fx * np.exp(0.03))
    assert values["depth_turn_x_deg"].value == pytest.approx(np.degrees(0.01))
    assert values["depth_shift_x_m"].value == pytest.approx(-0.025)
    alone = replace(found, depth_given=None)
    assert alone.depth_camera is None and not [v for v in alone.values() if v.name.startswith("depth_turn")]


def test_steps_between_are_those_that_were_taken():
    theta = np.zeros(len(NAMES))
    theta[:OF_ONE_CAMERA] = [-0.1, 0.003, 4.0, -7.0, 0.1, -0.2, 0.001, -0.002, 0.05, 0.004, 0.002, -0.01, 0.003]
    moved = OWN.moved(STEP)
    given, now = (OWN.camera, OWN.T_color_depth), (moved.camera, moved.T_color_depth)
    np.testing.assert_allclose(of_two.steps_between(given, now), STEP, atol=1e-12)
    camera = CameraParameters(COLOR, theta, 2.0).camera
    found = CameraParameters.between(COLOR, camera, STEP, 2.0)
    np.testing.assert_allclose(found.theta, [*theta[:OF_ONE_CAMERA], *STEP], atol=1e-12)


def test_a_second_fit_is_told_from_what_the_first_was_given():
    status = np.where(np.arange(len(NAMES)) >= OF_ONE_CAMERA, int(Status.ESTIMATED), int(Status.NO_GAIN))
    theta, more = np.zeros(len(NAMES)), np.zeros(len(NAMES))
    theta[OF_ONE_CAMERA:], more[OF_ONE_CAMERA:] = STEP, 0.1 * STEP[::-1]
    prior, surer = np.diag(prior_sigmas(COLOR, OWN.camera) ** 2), 1e-4 * np.eye(len(NAMES))
    first = Calibration(COLOR, theta, prior, status, 2.0, 0.5, 0.1, 0.02, OWN)
    color, own = first.as_given
    assert color.trust == COLOR.trust and own.camera.trust == OWN.camera.trust
    second = Calibration(color, more, surer, status, 2.0, 0.0, 0.0, 0.02, own, sigma_factor=2.5)
    both = second.continues(first)
    np.testing.assert_allclose(both.depth_camera.T_color_depth, second.depth_camera.T_color_depth, atol=1e-12)
    assert both.depth_camera.camera.fx == pytest.approx(second.depth_camera.camera.fx)
    assert both.given == COLOR and both.depth_given == OWN and both.gain == 0.5
    assert both.sigma_factor == 2.5
    np.testing.assert_array_equal(both.covariance, surer)


def test_what_two_fits_disagree_beyond_their_sigmas_enlarges_these():
    C = np.diag([0.01, 4.0, 1.0])
    C[0, 1] = C[1, 0] = 0.1999  # nearly singular: each parameter counts alone
    assert birge_ratio(np.array([0.3, -6.0, 3.0]), C) == pytest.approx(3.0)
    assert birge_ratio(np.array([0.01, 0.1, 0.5]), C) == 1.0


@pytest.mark.slow
def test_a_camera_that_changes_in_the_middle_has_larger_sigmas(monkeypatch):
    measured = known_two_cameras._measured

    def changed(scene, truth, rng):
        found = measured(scene, truth, rng)
        later = found.frame >= len(scene.T) // 2
        return replace(found, px_ideal=found.px_ideal + np.where(later, 10.0, 0.0)[:, None])

    factors = []
    for how in (measured, changed):
        monkeypatch.setattr(known_two_cameras, "_measured", how)
        rng = np.random.default_rng(3)
        found, _ = calibrated(room(rng), drawn(rng), rng)
        factors.append(found.sigma_factor)
    assert factors[0] < 2 and factors[1] > 2 * factors[0]


@pytest.mark.slow
def test_both_cameras_are_found_within_what_is_promised():
    rng = np.random.default_rng(3)
    scene: Room = room(rng)
    truth = drawn(rng)
    found, error = calibrated(scene, truth, rng)
    told = found.status == Status.ESTIMATED
    assert told[OF_ONE_CAMERA:].sum() >= 5 and told[:4].all()
    assert (np.abs(error[told]) < 3).mean() >= 0.85
    assert found.gain > 0.2
