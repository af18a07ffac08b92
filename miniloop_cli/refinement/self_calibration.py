"""The camera of a recording, from its own tracks: which parameters they tell, what these are, and how surely.

1. How many parameters: a ladder of models, each fitted to half of the tracks with what was known of the camera as
   prior. The one that predicts the other half best is taken, or a smaller one that is within a standard deviation.
2. That model is fitted to all tracks, in the end with sharp kernels.
3. A parameter that the recording tells no better than MAX_UNCERTAINTY of what was known before is held where it was,
   and the others are fitted again: a camera that only turns, a plane, or a single distance leave some of them open.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from miniloop_cli.geometry import depth_model
from miniloop_cli.geometry.camera_parameters import DISTORTION, INTRINSICS, NAMES, CameraParameters, numbers
from miniloop_cli.refinement.bundle import BundleSettings
from miniloop_cli.refinement.camera_measurements import CameraMeasurements, free_bundle
from miniloop_cli.refinement.camera_priors import SCALE, prior_sigmas
from miniloop_cli.refinement.camera_problem import CameraProblem
from miniloop_cli.refinement.held_out import HeldOut, held_out
from miniloop_cli.refinement.jackknife import image_part
from miniloop_cli.refinement.levenberg_marquardt import minimise
from miniloop_cli.refinement.rolling_shutter import MovingCamera, in_busiest_run
from miniloop_cli.refinement.timing import Measurements, corrected
from miniloop_cli.scene.calibration import Calibration, Status
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Floats, Ints

LOG = logging.getLogger("miniloop")
LADDER = ((), INTRINSICS, DISTORTION[:2], DISTORTION[2:], depth_model.NAMES)  # each model has those before it, too
MAX_FRAMES, MAX_OBSERVATIONS = 300, 30_000
MIN_OBSERVATIONS = 1000
MAX_UNCERTAINTY = 0.5  # of what was known before
MIN_GAIN, MIN_GAIN_SIGMAS = 0.002, 3.0  # of the cost of held-out tracks, below which nothing is worth changing
ROUGH_STEPS, FINE_STEPS = 20, 12


def self_calibrate(
    T_world_cam: Floats,
    tracked: Measurements,
    moving: MovingCamera,
    timing: Timing,
    rough: BundleSettings,
    fine: BundleSettings,
    jobs: int,
) -> Calibration | None:
    """The camera that the measurements speak for; None where there are too few of them to ask.

    T_world_cam (n, 4, 4): poses adjusted with the camera as it was given; `timing` is undone along their path.
    """
    part = tracked.subset(in_busiest_run(tracked.frame, MAX_FRAMES))
    part = part.subset(part.track % max(int(np.ceil(len(part.track) / MAX_OBSERVATIONS)), 1) == 0)
    if len(part.track) < MIN_OBSERVATIONS:
        return None
    camera = moving.camera
    px, z_m = corrected(part, moving.flow(part, T_world_cam, moving.path_twists(T_world_cam)), timing, camera)
    px = camera.distort(part.px_ideal) + (px - part.px_ideal)
    _, track = np.unique(part.track, return_inverse=True)
    measured = CameraMeasurements.of(part.frame, track, px, z_m, (camera.width, camera.height))
    middle_m = camera.depth_model.middle_m if not camera.depth_model.exact else float(np.nanmedian(measured.z_m))
    start = CameraParameters(camera, np.zeros(len(NAMES)), middle_m)
    fit = _Fit(T_world_cam, measured, moving, jobs)
    model, gain, gain_sigma = _chosen(fit, start, rough)
    sigma = prior_sigmas(camera)
    status = np.full(len(NAMES), int(Status.NO_GAIN))
    covariance = np.diag(sigma**2)
    parameters, free = start, model
    T = T_world_cam
    while len(free):
        start = replace(parameters, theta=np.where(np.isin(np.arange(len(NAMES)), free), parameters.theta, 0.0))
        problem, kept = fit.problem(T, measured, start, free, rough)
        minimise(problem, ROUGH_STEPS, rough.relative_tolerance)
        problem, kept = fit.problem(problem.bundle.T_world_cam, measured, problem.parameters, free, fine)
        minimise(problem, FINE_STEPS, fine.relative_tolerance)
        parameters, T = problem.parameters, problem.bundle.T_world_cam
        found = problem.covariance(image_part(kept.px, camera))
        unsure = np.sqrt(np.diag(found)) > MAX_UNCERTAINTY * sigma[free]
        if not unsure.any():
            covariance[np.ix_(free, free)] = found
            break
        free = free[~unsure]
    status[model] = int(Status.UNOBSERVABLE)
    status[free] = int(Status.ESTIMATED)
    theta = np.where(status == Status.ESTIMATED, parameters.theta, 0.0)
    return Calibration(camera, theta, covariance, status, middle_m, gain, gain_sigma, SCALE[camera.trust])


class _Fit:
    """Problems over the same recording."""

    def __init__(self, T: Floats, measured: CameraMeasurements, moving: MovingCamera, jobs: int) -> None:
        self.T, self.measured, self.moving, self.jobs = T, measured, moving, jobs

    def problem(
        self, T: Floats, measured: CameraMeasurements, start: CameraParameters, free: Ints, settings: BundleSettings
    ) -> tuple[CameraProblem, CameraMeasurements]:
        """With the parameters `free` (q,), from poses T (n, 4, 4); and the measurements that take part."""
        bundle, terms, kept = free_bundle(T, measured, start, settings, self.jobs, self.moving.terms)
        return CameraProblem(bundle, terms, start, free, prior_sigmas(start.given)[free]), kept


def _chosen(fit: _Fit, start: CameraParameters, settings: BundleSettings) -> tuple[Ints, float, float]:
    """The parameters (q,) of the model that held-out tracks speak for; its gain over none, and that's sigma."""
    inside = fit.measured.track % 2 == 0
    learned, other = fit.measured.subset(inside), fit.measured.subset(~inside)
    models: list[Ints] = []
    scores: list[HeldOut] = []
    T, parameters, free = fit.T, start, np.zeros(0, np.int64)
    for more in LADDER:
        if not parameters.bends and set(more) & set(DISTORTION):
            continue
        free = np.concatenate([free, numbers(*more)])
        problem, _ = fit.problem(T, learned, parameters, free, settings)
        minimise(problem, ROUGH_STEPS, settings.relative_tolerance)
        T, parameters = problem.bundle.T_world_cam, problem.parameters
        if parameters.camera.lens_fault():
            break
        models.append(free)
        scores.append(held_out(T, other, parameters, settings))
    best = int(np.argmax([score.gain_over(scores[0])[0] for score in scores]))
    for smaller in range(best):
        gain, sigma = scores[best].gain_over(scores[smaller])
        if gain < sigma:
            best = smaller
            break
    gain, sigma = scores[best].gain_over(scores[0])
    if best and not (gain > MIN_GAIN and gain > MIN_GAIN_SIGMAS * sigma):
        best = 0
    LOG.info("calibration: models by held-out tracks %s", [round(s.gain_over(scores[0])[0], 4) for s in scores])
    return models[best], gain, sigma


def recalibrated(measured: Measurements, calibration: Calibration) -> Measurements:
    """The measurements as the calibrated camera made them."""
    given, camera = calibration.given, calibration.camera
    px = given.distort(measured.px_ideal)
    step = calibration.parameters.depth_step(measured.z_m, depth_model.rho(px, given.width, given.height))
    z_m = measured.z_m + step
    return replace(measured, px_ideal=camera.undistort(px), z_m=np.where(z_m > 0, z_m, np.nan))
