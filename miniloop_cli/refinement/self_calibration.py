"""The camera of a recording, from its own tracks: which parameters they tell, what these are, and how surely.

1. How many parameters: a ladder of models, each fitted to half of the tracks with what was known of the camera as
   prior. The one that predicts the other half best is taken, or a smaller one that is within a standard deviation.
2. That model is fitted to all tracks, in the end with sharp kernels.
3. A parameter that the recording tells no better than MAX_UNCERTAINTY of what was known before is held where it was,
   and the others are fitted again: a camera that only turns, a plane, or a single distance leave some of them open.

A depth camera of its own, known but roughly, is read at the wrong place. Within a fit a reading moves along the slope
of the depth (two_cameras.py), after it the depth is registered to colour anew.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from miniloop_cli.geometry import depth_camera_parameters, depth_model, se3
from miniloop_cli.geometry.camera_parameters import (
    DISTORTION,
    INTRINSICS,
    NAMES,
    OF_ONE_CAMERA,
    CameraParameters,
    numbers,
)
from miniloop_cli.refinement.bundle import BundleSettings
from miniloop_cli.refinement.camera_measurements import CameraMeasurements, free_bundle
from miniloop_cli.refinement.camera_priors import SCALE, prior_sigmas
from miniloop_cli.refinement.camera_problem import CameraProblem
from miniloop_cli.refinement.held_out import held_out
from miniloop_cli.refinement.jackknife import image_part
from miniloop_cli.refinement.levenberg_marquardt import minimise
from miniloop_cli.refinement.rolling_shutter import MovingCamera, in_busiest_run
from miniloop_cli.refinement.timing import Measurements, corrected
from miniloop_cli.refinement.two_cameras import TwoCameras
from miniloop_cli.scene.calibration import Calibration, Status
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Floats, Ints

LOG = logging.getLogger("miniloop")
# Each model has the parameters of those before it, too.
LADDER: tuple[tuple[str, ...], ...] = (INTRINSICS, DISTORTION[:2], DISTORTION[2:], depth_model.NAMES)
# Where two cameras do not fit together nothing else can be told before they do.
LADDER_OF_TWO = ((*INTRINSICS, *depth_camera_parameters.NAMES), DISTORTION, depth_model.NAMES)
MAX_LOOKS, STEPS_A_LOOK, SETTLED_PX = 12, 4, 0.5
SIGMAS_OF_TWO = 3.0  # a larger model of two cameras must be better by so much: what is read changes with each, too
LEARNED, HELD_OUT = 0, 1  # every other track
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
    two: TwoCameras | None = None,
) -> Calibration | None:
    """The camera that the measurements speak for; None where there are too few of them to ask.

    T_world_cam (n, 4, 4): poses adjusted with the camera as it was given; `timing` is undone along their path.
    `two`: depth has a camera of its own, and is looked up again with each better one.
    """
    part = tracked.subset(in_busiest_run(tracked.frame, MAX_FRAMES))
    part = part.subset(part.track % max(int(np.ceil(len(part.track) / MAX_OBSERVATIONS)), 1) == 0)
    if len(part.track) < MIN_OBSERVATIONS:
        return None
    camera = moving.camera
    middle_m = camera.depth_model.middle_m if not camera.depth_model.exact else float(np.nanmedian(part.z_m))
    start = CameraParameters(camera, np.zeros(len(NAMES)), middle_m)
    fit = _Fit(T_world_cam, part, moving, timing, jobs, two)
    model, gain, gain_sigma, T, parameters = _chosen(fit, start, rough)
    sigma = fit.sigma(start)
    status = np.full(len(NAMES), int(Status.NO_GAIN))
    covariance = np.diag(sigma**2)
    free = model
    if len(free):  # the kernels of `fine` are sharp: before them all tracks agree roughly
        T, parameters, _, _ = fit.settled(T, parameters, free, rough, ROUGH_STEPS)
    while len(free):
        start = replace(parameters, theta=np.where(np.isin(np.arange(len(NAMES)), free), parameters.theta, 0.0))
        T, parameters, problem, kept = fit.settled(T, start, free, fine, FINE_STEPS)
        found = problem.covariance(image_part(kept.px, camera))
        unsure = np.sqrt(np.diag(found)) > MAX_UNCERTAINTY * sigma[free]
        if not unsure.any():
            covariance[np.ix_(free, free)] = found
            break
        free = free[~unsure]
    status[model] = int(Status.UNOBSERVABLE)
    status[free] = int(Status.ESTIMATED)
    theta = np.where(status == Status.ESTIMATED, parameters.theta, 0.0)
    given = two.given if two else None
    return Calibration(camera, theta, covariance, status, middle_m, gain, gain_sigma, SCALE[camera.trust], given)


class _Fit:
    """Problems over the same recording, whose measurements are those of `part`."""

    def __init__(
        self, T: Floats, part: Measurements, moving: MovingCamera, timing: Timing, jobs: int, two: TwoCameras | None
    ) -> None:
        self.T, self.moving, self.timing, self.jobs, self.two = T, moving, timing, jobs, two
        _, track = np.unique(part.track, return_inverse=True)
        self.part = replace(part, track=track)
        self.motion = moving.flow(part, T, moving.path_twists(T))
        self._read: dict[bytes, CameraMeasurements] = {}

    def sigma(self, parameters: CameraParameters) -> Floats:
        """(len(NAMES),) what was known of the parameters before."""
        return prior_sigmas(parameters.given, self.two.given.camera if self.two else None)

    def measured(self, parameters: CameraParameters, half: int | None = None) -> CameraMeasurements:
        """The measurements as they are read with these parameters; of every other track, or of all."""
        key = parameters.theta.tobytes() if self.two else b""
        if key not in self._read:
            self._read = {key: self._as_read(parameters)}
        found = self._read[key]
        return found if half is None else found.subset(found.track % 2 == half)

    def _as_read(self, parameters: CameraParameters) -> CameraMeasurements:
        camera, part, change = self.moving.camera, self.part, None
        seen = camera.distort(part.px_ideal)
        if self.two:
            z_m, slope, change = self.two.readings(parameters, part.frame, seen)
            part = replace(part, z_m=z_m, slope=slope)
        px, z_m = corrected(part, self.motion, self.timing, camera)
        px = seen + (px - part.px_ideal)
        return CameraMeasurements.of(part.frame, part.track, px, z_m, (camera.width, camera.height), change)

    def problem(
        self, T: Floats, measured: CameraMeasurements, start: CameraParameters, free: Ints, settings: BundleSettings
    ) -> tuple[CameraProblem, CameraMeasurements]:
        """With the parameters `free` (q,), from poses T (n, 4, 4); and the measurements that take part."""
        bundle, terms, kept = free_bundle(T, measured, start, settings, self.jobs, self.moving.terms)
        return CameraProblem(bundle, terms, start, free, self.sigma(start)[free]), kept

    def settled(
        self,
        T: Floats,
        parameters: CameraParameters,
        free: Ints,
        settings: BundleSettings,
        steps: int,
        half: int | None = None,
    ) -> tuple[Floats, CameraParameters, CameraProblem, CameraMeasurements]:
        """Poses and parameters at a minimum, the problem there and what took part in it.

        Depth of a camera of its own is looked up again with each answer, until it stays where it is.
        """
        looking = self.two is not None and bool((free >= OF_ONE_CAMERA).any())
        for _ in range(MAX_LOOKS if looking else 1):
            before = parameters
            problem, kept = self.problem(T, self.measured(parameters, half), parameters, free, settings)
            minimise(problem, STEPS_A_LOOK if looking else steps, settings.relative_tolerance)
            T, parameters = problem.bundle.T_world_cam, problem.parameters
            if looking and self._moved_px(before, parameters) < SETTLED_PX:
                break
        return T, parameters, problem, kept

    def _moved_px(self, before: CameraParameters, after: CameraParameters) -> float:
        """How far points at the corners of the image, 1 m and 3 m away, moved in the depth image at most."""
        assert self.two
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]) * [before.given.width, before.given.height]
        px = []
        for each in (before, after):
            own, color = self.two.at(each), each.camera
            rays = color.backproject(color.undistort(corners), np.ones(4))
            X = np.concatenate([rays, 3 * rays])
            px.append(own.camera.project(se3.transform(se3.inverse(own.T_color_depth), X)))
        return float(np.nanmax(np.linalg.norm(px[1] - px[0], axis=1)))


def _chosen(
    fit: _Fit, start: CameraParameters, settings: BundleSettings
) -> tuple[Ints, float, float, Floats, CameraParameters]:
    """The parameters (q,) of the model that held-out tracks speak for; its gain over none, and that's sigma.

    Also poses (n, 4, 4) and parameters as the other tracks have them.
    """
    models: list[Ints] = [np.zeros(0, np.int64)]
    first = fit.settled(fit.T, start, models[0], settings, ROUGH_STEPS, LEARNED)
    states = [first[:2]]
    for more in LADDER_OF_TWO if fit.two else LADDER:
        wanted = [name for name in more if start.bends or name not in DISTORTION]
        if not wanted:
            continue
        free = np.concatenate([models[-1], numbers(*wanted)])
        T, parameters, _, _ = fit.settled(*states[-1], free, settings, ROUGH_STEPS, LEARNED)
        if parameters.camera.lens_fault():
            break
        models.append(free)
        states.append((T, parameters))
    others = [fit.measured(parameters, HELD_OUT) for _, parameters in states]
    told = np.all([np.isfinite(other.z_m) for other in others], axis=0)  # the same readings must speak for all
    scores = [
        held_out(T, replace(other, z_m=np.where(told, other.z_m, np.nan)), parameters, settings)
        for (T, parameters), other in zip(states, others, strict=True)
    ]
    best = int(np.argmax([score.gain_over(scores[0])[0] for score in scores]))
    for smaller in range(best):
        gain, sigma = scores[best].gain_over(scores[smaller])
        if gain < (SIGMAS_OF_TWO if fit.two else 1.0) * sigma:
            best = smaller
            break
    gain, sigma = scores[best].gain_over(scores[0])
    if best and not (gain > MIN_GAIN and gain > MIN_GAIN_SIGMAS * sigma):
        best = 0
    LOG.info("calibration: models by held-out tracks %s", [round(s.gain_over(scores[0])[0], 4) for s in scores])
    return models[best], gain, sigma, *states[best]


def recalibrated(measured: Measurements, calibration: Calibration) -> Measurements:
    """The measurements as the calibrated camera made them."""
    given, camera = calibration.given, calibration.camera
    px = given.distort(measured.px_ideal)
    step = calibration.parameters.depth_step(measured.z_m, depth_model.rho(px, given.width, given.height))
    z_m = measured.z_m + step
    return replace(measured, px_ideal=camera.undistort(px), z_m=np.where(z_m > 0, z_m, np.nan))
