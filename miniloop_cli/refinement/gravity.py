"""Gravity in the refinement: the measured vertical of each frame keeps the poses upright; z is up.

An accelerometer measures gravity and its own acceleration. If frames are dense enough, the acceleration is computed
from the camera's path and subtracted. The rest has two errors: a constant rotation, from the mounting and the zero
offset of the sensor, and noise. Both are estimated from the recording.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.ransac.gravity_aligned import upright_rotations
from miniloop_cli.refinement.frame_velocity import path_runs
from miniloop_cli.refinement.robust import Robust
from miniloop_cli.refinement.terms import Gauge
from miniloop_cli.scene.priors import Accelerometer
from miniloop_cli.typing import Bools, Floats, Ints

LOG = logging.getLogger("miniloop")
GRAVITY_M_S2 = 9.81
WINDOW_S = 0.15  # standard deviation of the Gaussian over which readings around a frame are averaged
ASKEW_SIGMA_RAD = np.radians(3.0)  # per axis: how far a sensor is off its nominal axes, its zero offset included
MIN_SIGMA_RAD = np.radians(0.2)  # no accelerometer is better
KERNEL_SCALE = 2.0  # times the noise of a frame's vertical
MEDIAN_OF_RAYLEIGH = 1.1774  # the length of a two-dimensional Gaussian vector, in sigmas
ROUNDS = 20
LEAST_GAIN = 0.8  # the motion is subtracted if that reduces the noise to less than this share


@dataclass(frozen=True)
class GravityTerm:
    """Verticals up_cam (m, 3), unit vectors in the cameras `frames` (m, 1), against the world's z; sigma in radians."""

    frames: Ints
    up_cam: Floats
    sigma_rad: float
    robust: Robust
    gauge: Gauge = Gauge.HEADING

    def linearise(self, T_world_cam: Floats) -> tuple[Floats, Floats]:
        """R^T z - up of T_world_cam (n, 4, 4): 3 numbers a frame, two degrees of freedom, as both are unit vectors."""
        z_cam = T_world_cam[self.frames[:, 0], 2, :3]
        jacobian = np.zeros((len(z_cam), 1, 3, 6))
        jacobian[:, 0, :, :3] = se3.hat(z_cam) / self.sigma_rad  # (R exp(w))^T z = z_cam - w x z_cam
        return (z_cam - self.up_cam) / self.sigma_rad, jacobian


class Upright(NamedTuple):
    """A rotation T_up_world (4, 4) of the world that turns up to z, and the term that keeps it there."""

    T_up_world: Floats
    term: GravityTerm


def upright(accelerometer: Accelerometer, T_world_cam: Floats, stamps_s: Floats, known: Bools) -> Upright | None:
    """The rotation of the world to z up, from the readings (in the cameras' axes) and the `known` poses (n, 4, 4).

    stamps_s (n,) of the frames; known (n,). None where no frame with a pose has a reading.
    """
    force, own = felt(accelerometer, T_world_cam, stamps_s, known)
    frames = np.flatnonzero(np.all(np.isfinite(force), axis=1))
    if not len(frames):
        return None
    R, force, own = T_world_cam[frames, :3, :3], force[frames], own[frames]
    # Frames whose windows overlap share readings, so their weight is reduced to that of the readings.
    step_s = float(np.median(np.diff(stamps_s[frames]))) if len(frames) > 1 else np.inf
    sharing = max(1.0, 2 * np.sqrt(np.pi) * WINDOW_S / max(step_s, 1e-3))
    # Readings may point downwards at rest: then the acceleration in them has the opposite sign as well.
    still, moving, inverted = (_fit(R, force, sign * own, sharing) for sign in (0.0, 1.0, -1.0))
    best = moving if moving.noise_rad < LEAST_GAIN * still.noise_rad else still
    if inverted.noise_rad < LEAST_GAIN * best.noise_rad:
        best = inverted._replace(up_world=-inverted.up_world, up_cam=-inverted.up_cam)
    LOG.info(
        "the vertical of a frame is off by %.1f deg (one sigma), the sensor by %.1f deg; the model is turned: z is up",
        np.degrees(best.noise_rad),
        se3.rotation_angle_deg(best.askew),
    )
    spread = np.sqrt(sharing)
    robust = Robust("cauchy", KERNEL_SCALE / spread)
    term = GravityTerm(frames[:, None], best.up_cam, best.noise_rad * spread, robust)
    return Upright(se3.pose(upright_rotations(best.up_world[None])[0], np.zeros(3)), term)


def felt(accelerometer: Accelerometer, T_world_cam: Floats, stamps_s: Floats, known: Bools) -> tuple[Floats, Floats]:
    """Mean reading and mean acceleration of the camera around each frame, (n, 3), in its axes, in units of gravity.

    Poses T_world_cam (n, 4, 4), those that are `known` (n,), at `stamps_s` (n,). Both are means over the same readings,
    rotated along the path into the frame's axes. If frames are too far apart for a path, the reading is the
    accelerometer's mean direction and the acceleration is zero; NaN without readings.
    """
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    force = np.where(known[:, None], accelerometer.up, np.nan)
    own = np.zeros_like(force)
    unit = float(np.median(np.linalg.norm(accelerometer.readings, axis=1)))
    for run in path_runs(stamps_s, known):
        first, last = np.searchsorted(accelerometer.stamps_s, stamps_s[run[[0, -1]]])
        times = accelerometer.stamps_s[first:last]
        if not len(times):
            continue
        R = T_world_cam[run, :3, :3]
        turn = RotationSpline(stamps_s[run], Rotation.from_matrix(R))(times)
        force_world = turn.apply(accelerometer.readings[first:last]) / unit
        own_world = CubicSpline(stamps_s[run], T_world_cam[run, :3, 3])(times, 2) / GRAVITY_M_S2
        for f, R_world_cam in zip(run, R, strict=True):
            low, high = np.searchsorted(times, stamps_s[f] + np.array([-3, 3]) * WINDOW_S)
            if low == high or np.isnan(force[f, 0]):
                continue
            weight = np.exp(-0.5 * ((times[low:high] - stamps_s[f]) / WINDOW_S) ** 2)
            mean = weight @ np.concatenate([force_world[low:high], own_world[low:high]], axis=1) / weight.sum()
            force[f], own[f] = mean[:3] @ R_world_cam, mean[3:] @ R_world_cam
    return force, own


class _Fit(NamedTuple):
    up_world: Floats
    up_cam: Floats
    askew: Floats
    noise_rad: float


def _fit(R: Floats, force: Floats, own: Floats, sharing: float) -> _Fit:
    """The vertical of the world and of the cameras, from readings and accelerations (m, 3) of frames with rotations R.

    askew force - own must point along R^T up: Gauss-Newton over the two directions of up and the constant turn `askew`,
    whose prior is Gaussian, reweighted by a Cauchy kernel whose scale follows the noise.
    """
    up = np.einsum("mij,mj->i", R, force - own)
    up, askew, noise = up / np.linalg.norm(up), np.eye(3), np.radians(5.0)
    for _ in range(ROUNDS):
        turned = force @ askew.T
        length = np.linalg.norm(turned - own, axis=1, keepdims=True)
        up_cam = (turned - own) / length
        expected = up @ R
        residual = up_cam - expected
        noise = max(float(np.median(np.linalg.norm(residual, axis=1))) / MEDIAN_OF_RAYLEIGH, MIN_SIGMA_RAD)
        by_up, by_askew = R.transpose(0, 2, 1) @ se3.hat(up), -se3.hat(turned / length)
        J = np.concatenate([by_up, by_askew], axis=2)
        weight = Robust("cauchy", KERNEL_SCALE).weight((residual**2).sum(axis=1) / noise**2) / (sharing * noise**2)
        H = np.einsum("m,mki,mkj->ij", weight, J, J)
        g = np.einsum("m,mki,mk->i", weight, J, residual)
        H[:3, :3] += 1e-6 * np.trace(H) * np.outer(up, up)  # a turn about up is no change
        H[range(3, 6), range(3, 6)] += ASKEW_SIGMA_RAD**-2.0
        g[3:] += se3.log_so3(askew) / ASKEW_SIGMA_RAD**2
        step = -np.linalg.solve(H, g)
        up, askew = se3.exp_so3(step[:3]) @ up, se3.exp_so3(step[3:]) @ askew
    return _Fit(up, up_cam, askew, noise)
