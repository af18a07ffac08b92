"""Colour and depth cameras of a simulated room whose every error is known, and what a calibration makes of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from benchmarks.experiments.known_cameras import GUESSED, MIDDLE_M, ROUGH, SHARP, row_of, walk
from miniloop_cli.bench import Row
from miniloop_cli.config import Depth
from miniloop_cli.features.ray_depth import depth_on_rays
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.geometry.camera_parameters import NAMES, OF_DEPTH, CameraParameters
from miniloop_cli.refinement.camera_priors import prior_sigmas
from miniloop_cli.refinement.rolling_shutter import NO_TIMING, MovingCamera, adjust
from miniloop_cli.refinement.self_calibration import self_calibrate
from miniloop_cli.refinement.timing import Measurements
from miniloop_cli.refinement.two_cameras import TwoCameras
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.calibration import Calibration, Status
from miniloop_cli.scene.sequence import DepthCamera
from miniloop_cli.typing import Floats, Floats32, Ints

SIGMA_PX = 0.3
WALLS_M = np.array([[-2.2, 2.2], [-1.7, 1.7], [-0.8, 3.4]])  # of the room, about the place where the camera begins
OWN = DepthCamera(
    Camera(585.0, 585.0, 319.5, 239.5, 640, 480, trust=Trust.GUESS), tuple(np.eye(4).ravel().tolist())
)  # where and what it is taken to be


class Room(NamedTuple):
    """Poses (n, 4, 4) of the colour camera and points (p, 3) on the walls."""

    T: Floats
    X: Floats


def room(rng: Generator, frames: int = 16, points: int = 1200) -> Room:
    """A hand that looks around in a room."""
    direction = rng.normal([0.0, 0.0, 1.0], size=(points, 3))
    return Room(walk(rng, frames), direction * _distance(np.zeros(3), direction)[:, None])


def drawn(rng: Generator, share: float = 0.5) -> CameraParameters:
    """Errors of both guesses as their priors have them, times `share`; the depth itself errs by its noise only."""
    while True:
        theta = share * prior_sigmas(GUESSED, OWN.camera) * rng.standard_normal(len(NAMES))
        theta[OF_DEPTH] = 0.0
        found = CameraParameters(GUESSED, theta, MIDDLE_M)
        if not found.camera.lens_fault():
            return found


def calibrated(scene: Room, truth: CameraParameters, rng: Generator) -> tuple[Calibration | None, Floats]:
    """What the recording tells, from poses that begin a little off, and its errors in standard deviations."""
    images = depth_images(scene, truth, rng)

    def read_depth(color: Camera, own: DepthCamera, frame: Ints, px: Floats) -> tuple[Floats, Floats]:
        z_m, slope = np.full(len(px), np.nan), np.zeros((len(px), 2))
        for number in np.unique(frame):
            mine = frame == number
            z_m[mine], slope[mine] = depth_on_rays(images[number], px[mine], color, own, Depth())
        return z_m, slope

    n = len(scene.T)
    measured = _measured(scene, truth, rng)
    z_m, slope = read_depth(GUESSED, OWN, measured.frame, measured.px_ideal)
    measured = replace(measured, z_m=z_m, slope=slope)
    moving = MovingCamera(GUESSED, np.arange(n, dtype=float) * 10, np.ones(n, bool))
    off = se3.pose(se3.exp_so3(0.01 * rng.standard_normal((n, 3))), 0.01 * rng.standard_normal((n, 3)))
    begin = adjust(scene.T @ off, measured, GUESSED, ROUGH, 1).T_world_cam
    fine = replace(SHARP, depth_sigma_factor=1.0)
    found = self_calibrate(begin, measured, moving, NO_TIMING, ROUGH, fine, 1, TwoCameras(OWN, read_depth))
    return found, (found.theta - truth.theta) / found.sigmas if found else np.zeros(0)


def depth_images(scene: Room, truth: CameraParameters, rng: Generator) -> list[Floats32]:
    """What the true depth camera measures in each frame (h, w) m, with the noise of the model."""
    own = OWN.moved(truth.of_depth_camera)
    camera, T = own.camera, scene.T @ own.T_color_depth
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = camera.backproject(np.stack([u.ravel(), v.ravel()], 1).astype(float), np.ones(u.size))
    images = []
    for pose in T:
        z = _distance(pose[:3, 3], rays @ pose[:3, :3].T)
        z = z + camera.noise.sigma_m(z) * rng.standard_normal(len(z))
        images.append(z.reshape(u.shape).astype(np.float32))
    return images


def _measured(scene: Room, truth: CameraParameters, rng: Generator) -> Measurements:
    """Pixels of the points, as the given camera takes them; no depth yet."""
    frame, track = (k.ravel() for k in np.meshgrid(np.arange(len(scene.T)), np.arange(len(scene.X)), indexing="ij"))
    T = se3.inverse(scene.T)[frame]
    p_cam = np.einsum("kij,kj->ki", T[:, :3, :3], scene.X[track]) + T[:, :3, 3]
    ahead = p_cam[:, 2] > 0.4
    px = np.full((len(frame), 2), np.nan)
    px[ahead] = truth.camera.distort(truth.camera.project(p_cam[ahead]))
    kept = ((px >= 0) & (px <= [GUESSED.width - 1, GUESSED.height - 1])).all(axis=1)
    px = px[kept] + SIGMA_PX * rng.standard_normal((int(kept.sum()), 2))
    nothing = np.zeros(len(px))
    return Measurements(frame[kept], track[kept], nothing, GUESSED.undistort(px), nothing, np.zeros_like(px), nothing)


def _distance(origin: Floats, direction: Floats) -> Floats:
    """How many times the directions (k, 3) lead from `origin` to the walls."""
    with np.errstate(divide="ignore"):
        ends = (WALLS_M[None] - origin[None, :, None]) / direction[:, :, None]
    return np.asarray(np.where(ends > 0, ends, np.inf).min(axis=(1, 2)), float)


def two_camera_rows(runs: int, frames: int, points: int, seed: int, workers: Workers) -> Iterator[Row]:
    """A row for each parameter: errors in standard deviations over the runs, and how often it was estimated."""
    found: list[tuple[Floats, Ints]] = []
    for run in range(runs):
        rng = np.random.default_rng((seed, run))
        scene = room(rng, frames, points)
        calibration, error = calibrated(scene, drawn(rng), rng)
        if calibration is not None:
            found.append((error, calibration.status))
    for k, name in enumerate(NAMES):
        yield row_of(name, runs, np.array([error[k] for error, status in found if status[k] == Status.ESTIMATED]))
