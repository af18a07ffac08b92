"""The camera of a recording, estimated from its tracks: the parameters that they determine, with uncertainties.

1. The number of parameters: models of increasing size are fitted to half of the tracks, under the prior of the camera.
   The one that predicts the other half best is chosen, or a smaller one that is within a standard deviation of it.
2. That model is fitted to all tracks, finally with narrow kernels.
3. A parameter whose standard deviation is more than MAX_UNCERTAINTY of its prior keeps its given value, and the others
   are fitted again: a camera that only turns, a plane, or a single distance do not determine all of them.
4. With two cameras, the first and the second half of the frames are fitted alone. Errors of depth that is read at a
   slightly wrong place are shared by the whole image, and the jackknife over its parts does not see them; but the two
   halves see other surfaces from other places. Standard deviations are enlarged by what the halves disagree beyond
   them. Every other frame, or every other track, would share these errors.

With a roughly known separate depth camera, depth is read at wrong pixels. Within a fit, a reading changes by the slope
of the depth (two_cameras.py); after the fit, depth is registered to colour again.
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
from miniloop_cli.refinement.birge_ratio import birge_ratio
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
# Each model also has the parameters of those before it.
LADDER: tuple[tuple[str, ...], ...] = (INTRINSICS, DISTORTION[:2], DISTORTION[2:], depth_model.NAMES)
# The relative pose of two cameras comes first, as nothing else can be estimated before it.
LADDER_OF_TWO = ((*INTRINSICS, *depth_camera_parameters.NAMES), DISTORTION, depth_model.NAMES)
MAX_LOOKS, STEPS_A_LOOK, SETTLED_PX = 12, 4, 0.5
SIGMAS_OF_TWO = 3.0  # a larger model of two cameras must be better by so much, as the readings change with it
LEARNED, HELD_OUT = 0, 1  # every other track
MAX_FRAMES, MAX_OBSERVATIONS = 300, 30_000
MIN_OBSERVATIONS = 1000
MAX_UNCERTAINTY = 0.5  # of the prior
MIN_GAIN, MIN_GAIN_SIGMAS = 0.002, 3.0  # of the cost of held-out tracks; with less, the camera keeps its parameters
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
    """The camera estimated from the measurements; None if there are too few of them.

    T_world_cam (n, 4, 4): poses adjusted with the given camera; `timing` is corrected along their path.
    `two`: a separate depth camera, with which depth is read again after each fit. If its parameters are named there,
    they are fitted without a comparison of models, and the gain is 0.
    """
    part = tracked.subset(in_busiest_run(tracked.frame, MAX_FRAMES))
    part = part.subset(part.track % max(int(np.ceil(len(part.track) / MAX_OBSERVATIONS)), 1) == 0)
    if len(part.track) < MIN_OBSERVATIONS:
        return None
    camera = moving.camera
    middle_m = camera.depth_model.middle_m if not camera.depth_model.exact else float(np.nanmedian(part.z_m))
    start = CameraParameters(camera, np.zeros(len(NAMES)), middle_m)
    fit = _Fit(T_world_cam, part, moving, timing, jobs, two)
    if two and two.free:
        model, gain, gain_sigma, T, parameters = numbers(*two.free), 0.0, 0.0, T_world_cam, start
    else:
        model, gain, gain_sigma, T, parameters = _chosen(fit, start, rough)
    sigma = fit.sigma(start)
    status = np.full(len(NAMES), int(Status.NO_GAIN))
    covariance = np.diag(sigma**2)
    free = model
    if len(free):  # the kernels of `fine` are narrow, so all tracks are first fitted with wide ones
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
    calibration = Calibration(camera, theta, covariance, status, middle_m, gain, gain_sigma, SCALE[camera.trust])
    if two is None:
        return calibration
    factor = fit.disagreement_of_halves(T, parameters, free, fine) if len(free) else 1.0
    covariance[np.ix_(free, free)] *= factor**2
    return replace(calibration, depth_given=two.given, sigma_factor=factor)


class _Fit:
    """Fits over the measurements `part` of one recording."""

    def __init__(
        self, T: Floats, part: Measurements, moving: MovingCamera, timing: Timing, jobs: int, two: TwoCameras | None
    ) -> None:
        self.T, self.moving, self.timing, self.jobs, self.two = T, moving, timing, jobs, two
        _, track = np.unique(part.track, return_inverse=True)
        self.part = replace(part, track=track)
        self.motion = moving.flow(part, T, moving.path_twists(T))
        self._read: dict[bytes, CameraMeasurements] = {}

    def sigma(self, parameters: CameraParameters) -> Floats:
        """(len(NAMES),) the prior standard deviations."""
        return prior_sigmas(parameters.given, self.two.given.camera if self.two else None)

    def measured(self, parameters: CameraParameters, half: int | None = None) -> CameraMeasurements:
        """The measurements as read with these parameters: of every other track (`half`), or of all."""
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
        """The problem with the parameters `free` (q,), from poses T (n, 4, 4), and its measurements."""
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
        """Poses and parameters at a minimum, the problem there and its measurements.

        Depth of a separate camera is read again after each fit, until it no longer moves.
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

    def disagreement_of_halves(
        self, T: Floats, parameters: CameraParameters, free: Ints, settings: BundleSettings
    ) -> float:
        """The Birge ratio of the parameters `free` (q,), fitted to the first and to the second half of the frames.

        Both begin at poses T (n, 4, 4) and parameters that fit all frames. A track through both halves is divided.
        """
        frames = np.unique(self.part.frame)
        early = self.part.frame < frames[len(frames) // 2]
        step, covariance = np.zeros(len(free)), np.zeros((len(free), len(free)))
        for sign, rows in ((1, early), (-1, ~early)):
            half = _Fit(self.T, self.part.subset(rows), self.moving, self.timing, self.jobs, self.two)
            _, found, problem, kept = half.settled(T, parameters, free, settings, FINE_STEPS)
            step += sign * found.theta[free]
            covariance += problem.covariance(image_part(kept.px, self.moving.camera))
        return birge_ratio(step, covariance)

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
    """The parameters (q,) of the model chosen by held-out tracks; its gain over the given camera, and its sigma.

    Also poses (n, 4, 4) and parameters fitted to the other tracks.
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
    told = np.all([np.isfinite(other.z_m) for other in others], axis=0)  # models are compared on the same readings
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
