"""Rolling shutter and depth lag: undone where they were put in, found from the measurements, left alone otherwise."""

import dataclasses

import numpy as np
import pytest

from benchmarks.experiments.pose_errors import normalised_errors, within_2_sigma
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.bundle import BundleSettings
from miniloop_cli.refinement.frame_velocity import estimate_velocities, twists
from miniloop_cli.refinement.joint import SHARP
from miniloop_cli.refinement.rolling_shutter import (
    ASSUMED,
    CALIBRATION_FRAMES,
    NO_TIMING,
    MovingCamera,
    adjust,
    adjust_moving,
    calibrate,
    in_busiest_run,
)
from miniloop_cli.refinement.timing import Measurements, camera_depths, corrected, flow
from miniloop_cli.scene.timing import Timing

CAMERA = Camera(525, 525, 319.5, 239.5, 640, 480)
STAMPS_S = 100 + np.arange(25) / 5


def pose_at(t_s):
    """A smooth hand-held path: camera to world at times (n,) s."""
    w = np.stack([0.12 * np.sin(1.9 * t_s), 0.2 * np.sin(1.3 * t_s + 1), 0.1 * np.sin(2.3 * t_s)], axis=1)
    c = np.stack([0.3 * np.sin(1.1 * t_s), 0.2 * np.sin(1.7 * t_s + 2), 0.15 * np.cos(1.3 * t_s)], axis=1)
    return se3.pose(se3.exp_so3(w), c)


def trembling(t_s):
    """The same path in a hand that trembles three times a second, which frames taken at 5 Hz do not show."""
    phase = 2 * np.pi * 3.1 * t_s
    tremor = np.stack([np.sin(phase), np.cos(1.1 * phase), np.sin(0.9 * phase + 1)], axis=1)
    return pose_at(t_s) @ se3.pose(se3.exp_so3(0.008 * tremor), 0.004 * tremor[:, ::-1])


def velocities(path):
    """Velocity v (n, 3) m/s and angular velocity w (n, 3) rad/s in the camera's frame, at the stamps."""
    h = 1e-4
    before, now, after = (path(STAMPS_S + d) for d in (-h, 0, h))
    v = np.einsum("nji,nj->ni", now[:, :3, :3], (after - before)[:, :3, 3] / (2 * h))
    return v, se3.log_so3(np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]) / (2 * h)


def wall_depth(x, y):
    """Depth of the scene, a gently curved wall, over world x and y."""
    return 2.2 + 0.35 * x - 0.5 * y + 0.15 * x * x


def seen(t_s, X, path=pose_at):
    """Pixels (k, 2) and depths (k,) of world points X (k, 3) at times (k,)."""
    T = se3.inverse(path(t_s))
    p = np.einsum("kij,kj->ki", T[:, :3, :3], X) + T[:, :3, 3]
    return CAMERA.project(p), p[:, 2]


def depth_read(t_s, px, path=pose_at):
    """What a depth camera reads at pixels (k, 2) at times (k,): the ray's meeting with the wall."""
    T = path(t_s)
    ray = np.einsum("kij,kj->ki", T[:, :3, :3], CAMERA.backproject(px, np.ones(len(px))))
    z = np.full(len(px), 2.2)
    for _ in range(60):
        X = T[:, :3, 3] + ray * z[:, None]
        z -= 0.7 * (X[:, 2] - wall_depth(X[:, 0], X[:, 1]))
    return z


def recording(readout_s, lag_s, rng, noise_px=0.3, points=700, path=pose_at):
    """Measurements of random wall points by a camera whose rows and depth come late."""
    xy = rng.uniform(-1.6, 1.6, (points, 2))
    X = np.column_stack([xy, wall_depth(*xy.T)])
    frame, track = (k.ravel() for k in np.meshgrid(np.arange(len(STAMPS_S)), np.arange(points), indexing="ij"))
    t = STAMPS_S[frame]
    px, _ = seen(t, X[track], path)
    for _ in range(5):  # the row decides the time, the time decides the row
        px, _ = seen(t + readout_s * (px[:, 1] - 239.5) / 480, X[track], path)
    inside = (px >= 20).all(axis=1) & (px[:, 0] < 620) & (px[:, 1] < 460)
    frame, track, t, px = frame[inside], track[inside], t[inside], px[inside]
    stamp_lag_s = rng.uniform(-0.015, 0.015, len(STAMPS_S))[frame]
    late = t + readout_s * (px[:, 1] - 239.5) / 480 + stamp_lag_s + lag_s
    z = depth_read(late, px, path)
    step = 4 * np.eye(2)
    slope = np.stack([(depth_read(late, px + d, path) - depth_read(late, px - d, path)) / 8 for d in step], axis=1)
    z += 0.25 * CAMERA.noise.sigma_m(z) * rng.normal(size=len(z))
    row_share = (px[:, 1] - 239.5) / 480
    px = px + noise_px * rng.normal(size=px.shape)
    return Measurements(frame, track, row_share, px, z, slope, stamp_lag_s), X


def test_twists_are_the_derivatives_of_the_path():
    v, w = twists(pose_at(STAMPS_S), STAMPS_S, np.ones(len(STAMPS_S), bool))
    v_true, w_true = velocities(pose_at)
    assert np.abs(v - v_true)[2:-2].max() < 0.01
    assert np.abs(w - w_true)[2:-2].max() < 0.01


def test_no_motion_is_claimed_across_gaps_or_for_unknown_poses():
    stamps = STAMPS_S.copy()
    stamps[10:] += 60
    known = np.ones(25, bool)
    known[20:] = False
    v, _ = twists(pose_at(STAMPS_S), stamps, known)
    assert np.abs(v[20:]).max() == 0
    assert np.abs(v[:20]).max() < 1  # a spline across the gap would claim otherwise


def test_what_was_put_in_is_undone():
    measured, X = recording(0.025, -0.02, np.random.default_rng(0), noise_px=0)
    T = pose_at(STAMPS_S)
    v, w = twists(T, STAMPS_S, np.ones(25, bool))
    moving = flow(measured, camera_depths(measured, T, X), v, w, CAMERA)
    px, z = corrected(measured, moving, Timing(0.025, -0.02), CAMERA)
    px_true, z_true = seen(STAMPS_S[measured.frame], X[measured.track])
    middle = (measured.frame > 2) & (measured.frame < 22)
    before = np.linalg.norm(measured.px_ideal - px_true, axis=1)[middle]
    after = np.linalg.norm(px - px_true, axis=1)[middle]
    assert np.median(before) > 0.4
    assert np.median(after) < 0.1 * np.median(before)
    assert np.median(np.abs(z - z_true)[middle]) < 0.5 * np.median(np.abs(measured.z_m - z_true)[middle])


@pytest.mark.parametrize("motion", [(0.0, 3.3, 0.0, 0.0, 0.0, 0.0), (1.0, -2.0, 2.5, 0.6, -0.4, 0.8)])
def test_a_fast_turn_is_undone_into_the_corners(motion):
    """190 degrees a second: to first order of it, corners would be a pixel off."""
    w, v = np.split(np.array(motion), 2)
    rng, readout_s = np.random.default_rng(7), 0.03
    px_true = rng.uniform((0, 0), (640, 480), (300, 2))
    X = CAMERA.backproject(px_true, rng.uniform(0.8, 4.0, 300))
    share = np.zeros(300)
    for _ in range(30):  # the row decides the time, the time decides the row
        row_s = (readout_s * share)[:, None]
        R = se3.exp_so3(row_s * w)
        X_row = np.einsum("kji,kj->ki", R, X - row_s * v)
        share = (CAMERA.project(X_row)[:, 1] - 239.5) / 480
    none = np.zeros(300)
    measured = Measurements(
        np.zeros(300, int), np.arange(300), share, CAMERA.project(X_row), X_row[:, 2], np.zeros((300, 2)), none
    )
    moving = flow(measured, X[:, 2], v[None], w[None], CAMERA)
    px, z = corrected(measured, moving, Timing(readout_s, 0.0), CAMERA)
    np.testing.assert_allclose(px, px_true, atol=0.02)
    np.testing.assert_allclose(z, X[:, 2], atol=1e-4)
    first_order = measured.px_ideal - (readout_s * share)[:, None] * moving.px
    assert np.linalg.norm(first_order - px_true, axis=1).max() > 0.8


def test_velocities_that_cannot_be_leave_no_depth_behind_the_camera():
    """Poses of a false match give them; an adjustment refuses depths that are not positive."""
    measured, X = recording(0.025, -0.02, np.random.default_rng(0), noise_px=0)
    T, rng = pose_at(STAMPS_S), np.random.default_rng(1)
    v, w = 60 * rng.normal(size=(25, 3)), 30 * rng.normal(size=(25, 3))
    moving = flow(measured, camera_depths(measured, T, X), v, w, CAMERA)
    px, z = corrected(measured, moving, Timing(0.05, 0.1), CAMERA)
    assert np.isfinite(px).all()
    assert np.isnan(z).any()
    assert not (z <= 0).any()


@pytest.mark.parametrize(("readout_s", "lag_s"), [(0.02, -0.02), (0.03, 0.015), (0.0, -0.03)])
def test_the_two_times_are_found_from_the_measurements_alone(readout_s, lag_s):
    measured, _ = recording(readout_s, lag_s, np.random.default_rng(1))
    moving = MovingCamera(CAMERA, STAMPS_S, np.ones(25, bool))
    rough = BundleSettings(relative_tolerance=1e-3, covariance=False)
    timing, T = calibrate(pose_at(STAMPS_S), measured, moving, rough, 1)
    assert timing.readout_s == pytest.approx(readout_s, abs=0.003)
    assert timing.lag_s == pytest.approx(lag_s, abs=0.003)
    assert T.shape == (25, 4, 4)


def turning(readout_s, rng, frames=24, points=1500):
    """Measurements inside a round room of a camera that turns evenly, 15 degrees and a tenth of a second a frame."""
    around, height = rng.uniform(0, 2 * np.pi, points), rng.uniform(-1.5, 1.5, points)
    X = np.stack([2.5 * np.sin(around), height, 2.5 * np.cos(around)], axis=1)
    stamps_s = np.arange(frames) / 10

    def path(t_s):
        angle = np.radians(150) * t_s
        R = se3.exp_so3(np.stack([0 * angle, angle, 0 * angle], axis=1))
        return se3.pose(R, 0.3 * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1))

    frame, track = (k.ravel() for k in np.meshgrid(np.arange(frames), np.arange(points), indexing="ij"))
    ahead = seen(stamps_s[frame], X[track], path)[1] > 0.3
    frame, track = frame[ahead], track[ahead]
    px, z = seen(stamps_s[frame], X[track], path)
    for _ in range(8):
        px, z = seen(stamps_s[frame] + readout_s * (px[:, 1] - 239.5) / 480, X[track], path)
    inside = (z > 0.3) & (px >= 10).all(axis=1) & (px[:, 0] < 630) & (px[:, 1] < 470)
    frame, track, px, z = frame[inside], track[inside], px[inside], z[inside]
    row_share, none = (px[:, 1] - 239.5) / 480, np.zeros(len(z))
    px = px + 0.5 * rng.normal(size=px.shape)
    z = z + CAMERA.noise.sigma_m(z) * rng.normal(size=len(z))
    return Measurements(frame, track, row_share, px, z, np.zeros((len(z), 2)), none), path(stamps_s), stamps_s


def test_the_readout_of_a_camera_that_turns_evenly_is_found_although_poses_nearly_make_up_for_it():
    measured, T, stamps_s = turning(0.03, np.random.default_rng(6))
    moving = MovingCamera(CAMERA, stamps_s, np.ones(len(T), bool))
    rough = BundleSettings(relative_tolerance=1e-3, covariance=False)
    timing, _ = calibrate(T, measured, moving, rough, 1)
    assert timing.readout_s == pytest.approx(0.03, abs=0.006)
    assert timing.lag_s == pytest.approx(0, abs=0.003)


def test_a_part_of_a_long_recording_tells_the_times():
    """Its last ten frames come long after the others."""
    measured, _ = recording(0.02, -0.02, np.random.default_rng(1))
    frames = len(STAMPS_S) + CALIBRATION_FRAMES
    measured = dataclasses.replace(measured, frame=measured.frame + CALIBRATION_FRAMES * (measured.frame >= 15))
    stamps_s = 100 + np.arange(frames) / 5
    moving = MovingCamera(CAMERA, stamps_s, np.isin(np.arange(frames), measured.frame))
    T = pose_at(stamps_s)
    timing, same = calibrate(T, measured, moving, BundleSettings(relative_tolerance=1e-3, covariance=False), 1)
    assert same is T  # poses of a part do not fit the others any more
    assert timing.readout_s == pytest.approx(0.02, abs=0.003)
    assert timing.lag_s == pytest.approx(-0.02, abs=0.003)


def test_the_part_is_the_run_of_frames_with_most_observations():
    frame = np.repeat([0, 3, 4, 5, 9], [8, 2, 4, 5, 8])
    assert set(frame[in_busiest_run(frame, 3)]) == {3, 4, 5}
    assert set(frame[in_busiest_run(frame, 4)]) == {3, 4, 5}
    assert in_busiest_run(frame, 10).all()
    assert not len(in_busiest_run(frame[:0], 3))


def test_a_camera_without_either_is_left_alone():
    measured, _ = recording(0.0, 0.0, np.random.default_rng(2))
    still = Measurements(*(getattr(measured, n) for n in list(measured.__dataclass_fields__)[:-1]), 0 * measured.z_m)
    moving = MovingCamera(CAMERA, STAMPS_S, np.ones(25, bool))
    rough = BundleSettings(relative_tolerance=1e-3, covariance=False)
    timing, _ = calibrate(pose_at(STAMPS_S), still, moving, rough, 1)
    assert abs(timing.readout_s) < 0.002
    assert timing == NO_TIMING or abs(timing.lag_s) < 0.017  # the stamps said up to 15 ms and were not believed


def test_a_frames_rows_tell_its_motion_where_the_path_does_not():
    measured, _ = recording(0.025, -0.016, np.random.default_rng(3), path=trembling)
    moving, truth, timing = (
        MovingCamera(CAMERA, STAMPS_S, np.ones(25, bool)),
        trembling(STAMPS_S),
        Timing(0.025, -0.016),
    )
    _, w_true = velocities(trembling)
    rough = BundleSettings(relative_tolerance=1e-3, covariance=False)
    by_path, felt = (adjust_moving(truth, measured, moving, timing, rough, rough, 1, feel)[0] for feel in (False, True))

    def error(result):
        """Mean errors of relative poses, degrees and millimetres."""
        T, at = (se3.inverse(p[:-1]) @ p[1:] for p in (result.T_world_cam, truth))
        E = se3.inverse(T) @ at
        return se3.rotation_angle_deg(E[:, :3, :3]).mean(), 1e3 * np.linalg.norm(E[:, :3, 3], axis=1).mean()

    assert error(felt)[0] < 0.7 * error(by_path)[0]
    assert error(felt)[1] < 0.7 * error(by_path)[1]

    path = moving.path_twists(truth)
    px, z_m = corrected(measured, moving.flow(measured, truth, path), timing, CAMERA)
    settled = adjust(truth, measured, CAMERA, rough, 1, px, z_m)
    found, _ = estimate_velocities(path, path, measured, settled, timing, CAMERA, rough)
    assert np.linalg.norm(found[1] - w_true, axis=1).mean() < 0.7 * np.linalg.norm(path[1] - w_true, axis=1).mean()


@pytest.mark.slow
def test_poses_are_as_uncertain_as_their_motion_makes_them():
    """Whether a pose is off or its velocity, the rows of a frame can hardly tell: both were found from them."""
    errors, of_known_motion = [], []
    moving, truth = MovingCamera(CAMERA, STAMPS_S, np.ones(25, bool)), trembling(STAMPS_S)
    timing, rough = Timing(0.025, -0.016), BundleSettings(relative_tolerance=1e-3, covariance=False)
    for seed in range(3):
        measured, _ = recording(0.025, -0.016, np.random.default_rng(seed), path=trembling)
        run, *_ = adjust_moving(truth, measured, moving, timing, rough, SHARP, 1)
        errors.append(normalised_errors(run.T_world_cam, truth, run.covariance))
        undone = corrected(measured, moving.flow(measured, truth, velocities(trembling)), timing, CAMERA)
        known = adjust(run.T_world_cam, measured, CAMERA, SHARP, 1, *undone)
        of_known_motion.append(normalised_errors(run.T_world_cam, truth, known.covariance))
    assert 0.92 < within_2_sigma(np.concatenate(errors)) < 0.99
    assert 0.75 < np.sqrt((np.concatenate(errors) ** 2).mean()) < 1.1
    assert within_2_sigma(np.concatenate(of_known_motion)) < 0.85


def test_frames_that_see_too_little_keep_the_motion_of_the_path():
    measured, _ = recording(0.025, -0.016, np.random.default_rng(4), points=300)
    few = measured.subset((measured.frame != 7) | (np.cumsum(measured.frame == 7) < 10))
    moving, T = MovingCamera(CAMERA, STAMPS_S, np.ones(25, bool)), pose_at(STAMPS_S)
    path, timing = moving.path_twists(T), Timing(0.025, -0.016)
    rough = BundleSettings(relative_tolerance=1e-3, covariance=False)
    settled = adjust(T, few, CAMERA, rough, 1, *corrected(few, moving.flow(few, T, path), timing, CAMERA))
    (v, w), unsure = estimate_velocities(path, path, few, settled, timing, CAMERA, rough)
    assert not unsure[7].any()
    assert np.linalg.eigvalsh(unsure[8]).min() > -1e-12 < unsure[8].trace()
    assert np.array_equal(v[7], path[0][7])
    assert np.array_equal(w[7], path[1][7])
    assert not np.array_equal(w[8], path[1][8])


@pytest.mark.slow
@pytest.mark.parametrize(("readout_s", "gains"), [(0.025, True), (0.0, False)])
def test_frames_too_far_apart_for_a_path_still_tell_their_motion(readout_s, gains):
    measured, _ = recording(readout_s, 0.0, np.random.default_rng(5), path=trembling)
    measured = dataclasses.replace(measured, stamp_lag_s=np.zeros(len(measured.frame)))
    moving, truth = MovingCamera(CAMERA, 60 * STAMPS_S, np.ones(25, bool)), trembling(STAMPS_S)
    rough = BundleSettings(relative_tolerance=1e-3, covariance=False)
    timing, _ = calibrate(truth, measured, moving, rough, 1)
    assert timing == NO_TIMING, "a minute apart, no path tells of it"
    plain = adjust(truth, measured, CAMERA, rough, 1)
    result, used, _ = adjust_moving(truth, measured, moving, timing, rough, rough, 1)
    assert used == (ASSUMED if gains else NO_TIMING)

    def error_mm(found):
        E = se3.inverse(se3.inverse(found.T_world_cam[:-1]) @ found.T_world_cam[1:])
        return 1e3 * np.linalg.norm((E @ se3.inverse(truth[:-1]) @ truth[1:])[:, :3, 3], axis=1).mean()

    if gains:
        assert error_mm(result) < 0.8 * error_mm(plain)
    else:
        again = adjust(plain.T_world_cam, measured, CAMERA, rough, 1, points=plain.points_world)
        assert np.array_equal(result.T_world_cam, again.T_world_cam)
