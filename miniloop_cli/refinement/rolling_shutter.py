"""Bundle adjustment of a moving camera with two unknown times, and its motion within each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.bundle import BundleResult, BundleSettings, bundle_adjust
from miniloop_cli.refinement.frame_velocity import estimate_velocities, twists
from miniloop_cli.refinement.gauge import with_own_errors
from miniloop_cli.refinement.gravity import upright
from miniloop_cli.refinement.terms import PoseTerm
from miniloop_cli.refinement.timing import Flow, Measurements, camera_depths, corrected, flow, slopes
from miniloop_cli.scene.priors import Accelerometer
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Bools, Floats, Ints

Twists = tuple[Floats, Floats]
CALIBRATION_FRAMES, CALIBRATION_OBSERVATIONS = 300, 30_000  # suffice for two parameters
LEAST_GAIN = 0.002  # share of the cost by which timing must reduce it to be accepted
MOST_S = 0.1  # more than the lag of any sensor
MOST_STEPS, LONGEST_STEP_S, SETTLED_S = 8, 0.02, 0.0015
FOLLOWING = 0.15  # about the share of the cost's curvature by a time that is left once poses and points follow
REST = 1e-4  # relative change of the cost at which poses and points have followed
FELT_STEPS = 2  # adjustments after which the motion within frames is estimated again
MIN_VELOCITY_GAIN = 0.04  # more than six velocities a frame gain for a camera without rolling shutter
NO_TIMING, ASSUMED = Timing(), Timing(readout_s=0.02)


@dataclass(frozen=True)
class MovingCamera:
    """A camera, the colour stamps (n,) of its frames in seconds, and which of them have a pose (n,).

    `accelerometer`: readings in the camera's axes, if there are any. `terms`: further measurements of the poses.
    """

    camera: Camera
    stamps_s: Floats
    known: Bools
    accelerometer: Accelerometer | None = None
    terms: tuple[PoseTerm, ...] = ()

    def path_twists(self, T_world_cam: Floats) -> Twists:
        """Velocities (n, 3) of the path through the poses (n, 4, 4)."""
        return twists(T_world_cam, self.stamps_s, self.known)

    def flow(self, measured: Measurements, T_world_cam: Floats, motion: Twists, points: Floats | None = None) -> Flow:
        """Motion of the measured points in the images, at the depths of `points` (p, 3) or at those measured.

        Poses T_world_cam (n, 4, 4).
        """
        unknown = np.full((int(measured.track.max(initial=-1)) + 1, 3), np.nan)
        depth_m = camera_depths(measured, T_world_cam, unknown if points is None else points)
        return flow(measured, depth_m, *motion, self.camera)


def adjust(
    T: Floats, measured: Measurements, camera: Camera, settings: BundleSettings, jobs: int,
    px: Floats | None = None, z_m: Floats | None = None, points: Floats | None = None,
    pose_terms: Sequence[PoseTerm] = (),
) -> BundleResult:  # fmt: skip
    """Bundle adjustment of the measurements, or of their corrected values px (k, 2) and z_m (k,).

    It starts from the poses T (n, 4, 4), and from `points` (p, 3), if given.
    """
    px, z_m = measured.px_ideal if px is None else px, measured.z_m if z_m is None else z_m
    return bundle_adjust(
        T, measured.frame, measured.track, px, z_m, camera, settings, jobs, points_world=points, pose_terms=pose_terms
    )


def adjust_upright(
    T: Floats, measured: Measurements, moving: MovingCamera, settings: BundleSettings, jobs: int,
    px: Floats | None = None, z_m: Floats | None = None, points: Floats | None = None,
) -> BundleResult:  # fmt: skip
    """`adjust` of T (n, 4, 4), held upright if there is an accelerometer, in a world whose z is up.

    px (k, 2), z_m (k,) and points (p, 3) as in `adjust`.
    """
    found = None
    if moving.accelerometer is not None:
        found = upright(moving.accelerometer, T, moving.stamps_s, moving.known)
    if found is None:
        return adjust(T, measured, moving.camera, settings, jobs, px, z_m, points, moving.terms)
    T = found.T_up_world @ T
    points = None if points is None else se3.transform(found.T_up_world, points)
    return adjust(T, measured, moving.camera, settings, jobs, px, z_m, points, [found.term, *moving.terms])


def adjust_moving(
    T: Floats, measured: Measurements, moving: MovingCamera, timing: Timing,
    rough: BundleSettings, fine: BundleSettings, jobs: int, feel: bool = True,
) -> tuple[BundleResult, Timing, Twists | None]:  # fmt: skip
    """Bundle adjustment of T (n, 4, 4) corrected for timing and motion; also the timing and the motion.

    The motion within the frames is first that of the path through the poses. Then, if `feel`, it is estimated from the
    measurements of each frame, alternately with poses and points. Frames too far apart for a path do not determine the
    timing. But a pixel moves by motion times readout, so their motion can be estimated with an ASSUMED readout; that
    result is used if it reduces the cost by more than MIN_VELOCITY_GAIN.
    """
    if timing != NO_TIMING:
        result, motion = _undone(T, measured, moving, timing, rough, fine, jobs, feel)
        return result, timing, motion
    even = replace(rough, relative_tolerance=fine.relative_tolerance)
    plain = adjust(T, measured, moving.camera, even, jobs, pose_terms=moving.terms)
    T, points, cost = plain.T_world_cam, plain.points_world, plain.descent.cost_after
    del plain  # its residuals are as large as the measurements
    on_path = moving.path_twists(T)[1].any(axis=1)
    if feel and on_path.sum() <= moving.known.sum() / 2:
        images_only = replace(moving, accelerometer=None)
        felt, _ = _undone(T, measured, images_only, ASSUMED, rough, even, jobs, True)
        if felt.descent.cost_after < (1 - MIN_VELOCITY_GAIN) * cost:
            result, motion = _undone(felt.T_world_cam, measured, moving, ASSUMED, rough, fine, jobs, True)
            return result, ASSUMED, motion
    return adjust_upright(T, measured, moving, fine, jobs, points=points), timing, None


def _undone(
    T: Floats, measured: Measurements, moving: MovingCamera, timing: Timing,
    rough: BundleSettings, fine: BundleSettings, jobs: int, feel: bool,
) -> tuple[BundleResult, Twists]:  # fmt: skip
    motion = moving.path_twists(T)
    px, z_m = corrected(measured, moving.flow(measured, T, motion), timing, moving.camera)
    points, unsure = None, np.zeros((len(T), 6, 6))
    for _ in range(FELT_STEPS if feel else 0):
        result = adjust(T, measured, moving.camera, rough, jobs, px, z_m, points, moving.terms)
        T, points, path = result.T_world_cam, result.points_world, moving.path_twists(result.T_world_cam)
        motion, unsure = estimate_velocities(path, motion, measured, result, timing, moving.camera, rough)
        px, z_m = corrected(measured, moving.flow(measured, T, motion, points), timing, moving.camera)
    result = adjust_upright(T, measured, moving, fine, jobs, px, z_m, points)
    if result.covariance is None:
        return result, motion
    covariance = with_own_errors(result.covariance, result.T_world_cam, unsure, result.fixed_frame)
    return replace(result, covariance=covariance), motion


def calibrate(
    T: Floats, tracked: Measurements, moving: MovingCamera, rough: BundleSettings, jobs: int
) -> tuple[Timing, Floats]:
    """Readout time and lag of depth (s) with least cost; poses (n, 4, 4) adjusted with them.

    Quasi-Newton steps in the two times, each after a bundle adjustment of part of the tracks (of a long recording: in
    part of its frames), where the slopes of the cost are exact. The Hessian is learned from step to step, as it depends
    on how far poses and points follow: for a camera that turns evenly, they compensate nearly everything. The timing is
    zero if it reduces the cost by less than LEAST_GAIN, or if the times exceed what a sensor can have.
    """
    part = tracked.subset(in_busiest_run(tracked.frame, CALIBRATION_FRAMES))
    whole = len(part.track) == len(tracked.track)
    every = int(np.ceil(len(part.track) / CALIBRATION_OBSERVATIONS))
    part = part.subset(part.track % max(every, 1) == 0)
    if not len(part.track):
        return NO_TIMING, T
    # The slopes are exact only if poses and points are at a minimum.
    settings = replace(rough, relative_tolerance=REST)
    sigma_z_m = rough.depth_sigma_factor * moving.camera.noise.sigma_m(np.nan_to_num(part.z_m, nan=1.0))
    # The stamps are exact except for the two unknown times; (0, 0) means that they are exact.
    plain = result = adjust(T, part, moving.camera, settings, jobs, pose_terms=moving.terms)
    times, step, before, hessian = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros((2, 2))
    for k in range(MOST_STEPS):
        path_flow = _path_flow(moving, part, result)
        px, z_m = corrected(part, path_flow, Timing(*times), moving.camera)
        result = adjust(
            result.T_world_cam, part, moving.camera, settings, jobs, px, z_m, result.points_world, moving.terms
        )
        gradient, alone = slopes(part, path_flow, result, settings.sigma_px, sigma_z_m)
        hessian = _learned(hessian, step, gradient - before) if k else FOLLOWING * np.diag(alone)
        if k > 1 and np.abs(step).max() < SETTLED_S:
            break
        step, before = _downhill(gradient, hessian), gradient
        times = times + step
    least = (1 - LEAST_GAIN) * plain.descent.cost_after  # no gain is possible without measurements
    if not result.descent.cost_after < least or not (np.abs(times) < MOST_S).all():
        return NO_TIMING, plain.T_world_cam if whole else T
    return Timing(float(times[0]), float(times[1])), result.T_world_cam if whole else T


def _downhill(gradient: Floats, hessian: Floats) -> Floats:
    """Newton's step (2,), at most LONGEST_STEP_S along each axis of the Hessian; that long if it is negative there."""
    curvature, axes = np.linalg.eigh(hessian)
    along = gradient @ axes
    enough = curvature * LONGEST_STEP_S > np.abs(along)
    return -axes @ np.where(enough, along / np.where(enough, curvature, 1.0), LONGEST_STEP_S * np.sign(along))


def _learned(hessian: Floats, step: Floats, change: Floats) -> Floats:
    """The Hessian (2, 2) updated by the change of the gradient along a step (BFGS), if it stays positive."""
    curvature, old = step @ change, hessian @ step
    if not curvature > 0 or not step @ old > 0:
        return hessian
    return hessian + np.outer(change, change) / curvature - np.outer(old, old) / (step @ old)


def in_busiest_run(frame: Ints, length: int) -> Bools:
    """Observations (k,) bool of the `length` consecutive frames that have most of them; frame (k,) ints."""
    until = np.concatenate([np.zeros(1, np.int64), np.cumsum(np.bincount(frame))])
    first = int(np.argmax(until[length:] - until[:-length])) if len(until) > length else 0
    return (frame >= first) & (frame < first + length)


def _path_flow(moving: MovingCamera, measured: Measurements, result: BundleResult) -> Flow:
    T = result.T_world_cam
    return moving.flow(measured, T, moving.path_twists(T), result.points_world)
