"""Tracks of simulated cameras whose every error is known, and what a calibration makes of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from numpy.random import Generator

from miniloop_cli.bench import Row
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.geometry.camera_parameters import NAMES, OF_DEPTH, OF_ONE_CAMERA, OF_PIXELS, CameraParameters
from miniloop_cli.geometry.depth_model import rho
from miniloop_cli.refinement.bundle import BundleSettings
from miniloop_cli.refinement.camera_priors import prior_sigmas
from miniloop_cli.refinement.joint import SHARP
from miniloop_cli.refinement.rolling_shutter import NO_TIMING, MovingCamera, adjust
from miniloop_cli.refinement.self_calibration import self_calibrate
from miniloop_cli.refinement.timing import Measurements
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.calibration import Calibration, Status
from miniloop_cli.typing import Floats, Ints

GUESSED = Camera(525.0, 525.0, 319.5, 239.5, 640, 480, trust=Trust.GUESS)
ROUGH = BundleSettings(depth_sigma_factor=1.0, relative_tolerance=1e-3, covariance=False)
MIDDLE_M = 2.0
FIXED_POINT_STEPS = 30


def walk(rng: Generator, frames: int, turning_only: bool = False) -> Floats:
    """(n, 4, 4) poses of a hand that looks around in a room, camera to world."""
    s = np.linspace(0, 2 * np.pi, frames, endpoint=False)[:, None]
    phase = rng.uniform(0, 2 * np.pi, (2, 3))
    w = np.array([0.25, 0.5, 0.4]) * np.sin(s * [2, 1, 3] + phase[0])
    t = np.array([0.5, 0.35, 0.4]) * np.sin(s * [1, 2, 1] + phase[1])
    return se3.pose(se3.exp_so3(w), np.zeros_like(t) if turning_only else t)


def cloud(rng: Generator, points: int, plane: bool = False) -> Floats:
    """(p, 3) points before the camera, 1 to 4 m away; or on one wall, at right angles to the view."""
    X = np.column_stack([rng.uniform(-2.5, 2.5, points), rng.uniform(-2, 2, points), rng.uniform(1, 4, points)])
    if plane:
        X[:, 2] = 2.2
    return X


def recording(
    T: Floats, X: Floats, camera: Camera, truth: CameraParameters, rng: Generator, sigma_px: float = 0.3
) -> Measurements:
    """What a camera with the true parameters measures of points X (p, 3) from poses T (n, 4, 4), as `camera` takes it.

    Depth has the noise of the camera's model.
    """
    frame, track = (k.ravel() for k in np.meshgrid(np.arange(len(T)), np.arange(len(X)), indexing="ij"))
    p_cam = np.einsum("kij,kj->ki", se3.inverse(T)[frame][:, :3, :3], X[track]) + se3.inverse(T)[frame][:, :3, 3]
    ahead = p_cam[:, 2] > 0.4
    px = np.full((len(frame), 2), np.nan)
    px[ahead] = truth.camera.distort(truth.camera.project(p_cam[ahead]))
    kept = ((px >= 0) & (px <= [camera.width - 1, camera.height - 1])).all(axis=1)
    frame, track, px, z_m = frame[kept], track[kept], px[kept], p_cam[kept, 2]
    edge = rho(px, camera.width, camera.height)
    reading = z_m.copy()
    for _ in range(FIXED_POINT_STEPS):
        reading = z_m - truth.depth_step(reading, edge)
    reading += camera.noise.sigma_m(reading) * rng.standard_normal(len(reading))
    px = px + sigma_px * rng.standard_normal(px.shape)
    nothing = np.zeros(len(frame))
    return Measurements(frame, track, nothing, camera.undistort(px), reading, np.zeros_like(px), nothing)


def drawn(rng: Generator, camera: Camera, share: float = 0.5) -> CameraParameters:
    """Errors of the given camera as its priors have them, times `share`; no lens that folds."""
    while True:
        theta = share * prior_sigmas(camera) * rng.standard_normal(len(NAMES))
        theta[OF_ONE_CAMERA:] = 0.0
        found = CameraParameters(camera, theta, MIDDLE_M)
        if not found.camera.lens_fault():
            return found


def calibrated(measured: Measurements, T: Floats, camera: Camera, rng: Generator) -> Calibration | None:
    """The calibration from poses that begin a little off the true ones."""
    n = len(T)
    moving = MovingCamera(camera, np.arange(n, dtype=float) * 10, np.ones(n, bool))
    off = se3.pose(se3.exp_so3(0.01 * rng.standard_normal((n, 3))), 0.01 * rng.standard_normal((n, 3)))
    begin = adjust(T @ off, measured, camera, ROUGH, 1).T_world_cam
    return self_calibrate(begin, measured, moving, NO_TIMING, ROUGH, replace(SHARP, depth_sigma_factor=1.0), 1)


def true_theta(truth: CameraParameters, middle_m: float) -> Floats:
    """The true parameters with depth taken to be right at another distance: the world is a little larger there.

    With unit u, depths are u times what they were; then offset and bends are, too, and what bends towards the corners
    adds to what is the same at all distances.
    """
    offset, bend, radial, radial_bend = truth.theta[OF_DEPTH]
    at_middle = middle_m + float(
        offset * (1 - middle_m / truth.middle_m) + bend * middle_m * (middle_m - truth.middle_m)
    )
    u = middle_m / at_middle
    of_depth = u * np.array([offset, bend, radial + radial_bend * (middle_m - truth.middle_m), radial_bend])
    return np.concatenate([truth.theta[:OF_PIXELS], of_depth, truth.theta[OF_ONE_CAMERA:]])


def camera_rows(runs: int, frames: int, points: int, seed: int, workers: Workers) -> Iterator[Row]:
    """A row for each parameter: errors in standard deviations over the runs, and how often it was held."""
    found = [
        one for run in range(runs) if (one := _run(np.random.default_rng((seed, run)), frames, points)) is not None
    ]
    for k, name in enumerate(NAMES[:OF_ONE_CAMERA]):
        yield row_of(name, runs, np.array([each[0][k] for each in found if each[1][k] == Status.ESTIMATED]))


def row_of(parameter: str, runs: int, sigmas: Floats) -> Row:
    """A row of the table; sigmas (k,): errors of a parameter in standard deviations, in the runs that estimated it."""
    return {
        "parameter": parameter,
        "runs": runs,
        "estimated": len(sigmas),
        "within_3_sigma": float((np.abs(sigmas) < 3).mean()) if len(sigmas) else None,
        "rms_sigmas": float(np.sqrt((sigmas**2).mean())) if len(sigmas) else None,
    }


def _run(rng: Generator, frames: int, points: int) -> tuple[Floats, Ints] | None:
    """Errors of one simulated camera's parameters in their standard deviations, and what became of each."""
    T, X, truth = walk(rng, frames), cloud(rng, points), drawn(rng, GUESSED)
    found = calibrated(recording(T, X, GUESSED, truth, rng), T, GUESSED, rng)
    if found is None:
        return None
    return (found.theta - true_theta(truth, found.middle_m)) / found.sigmas, found.status


def draw(rows: Sequence[Row]) -> Figure:
    """The share of runs within 3 sigma, a bar for each parameter."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    axes.barh([row["parameter"] for row in rows], [100 * (row["within_3_sigma"] or 0) for row in rows])
    axes.axvline(95, color="k", linestyle="--", linewidth=1)
    axes.invert_yaxis()
    axes.set(xlabel="runs within 3 sigma [%]", xlim=(0, 100))
    return figure
