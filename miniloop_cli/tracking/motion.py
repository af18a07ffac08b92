"""The robust pose of a frame from the pixels and depths of points that are known in an earlier frame."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.partial_motion import PartialMotion
from miniloop_cli.scene.tracked import ENOUGH_POINTS
from miniloop_cli.typing import Bools, Floats

SIGMA_PX, DEPTH_SIGMA_FACTOR = 1.0, 2.0
STEPS = 10
SCALES_PX = (2.0, 8.0)  # of the kernel, least and most; rolling shutter causes residuals of some pixels in fast motion
FAR = 3.0  # times the scale: larger residuals are outliers
MIN_SHARE = 0.3  # of seen points that must agree
MIN_HELPED = 6  # points that must agree where depth tells a part of the motion
MAX_CHI2 = 25.0  # of what is known, after it was adjusted with the points; six directions
SETTLED = 1e-5  # rad, m
NEAR_M = 0.05


class Measured(NamedTuple):
    """Points of a keyframe in a frame: p_key (n, 3) m, px_ideal (n, 2) undistorted pixels, z_m (n,) or NaN."""

    p_key: Floats
    px_ideal: Floats
    z_m: Floats


NOTHING_MEASURED = Measured(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0))


class Motion(NamedTuple):
    """T_cam_key (4, 4): points of the key camera in this one; information (6, 6) of (w, v) in [exp(w) | v] T_cam_key;
    `agrees` (n,): the points that move like this."""

    T_cam_key: Floats
    information: Floats
    agrees: Bools


def frame_motion(
    points: Measured, T_cam_key: Floats, camera: Camera, known: PartialMotion | None = None
) -> Motion | None:
    """The motion of a frame from points, and from what else is `known` of it.

    Gauss-Newton from T_cam_key (4, 4), reweighted by a Cauchy kernel whose scale follows the residuals. None where
    fewer than ENOUGH_POINTS agree (MIN_HELPED if something is known), or less than MIN_SHARE of them, or where they
    contradict what is known.
    """
    from scipy.linalg.lapack import dposv

    p_key, px_ideal, z_m = points
    least = MIN_HELPED if known else ENOUGH_POINTS
    if len(p_key) < least:
        return None
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    sigma_z_m = DEPTH_SIGMA_FACTOR * camera.noise.sigma_m(np.nan_to_num(z_m, nan=1.0))
    T, scale = T_cam_key.copy(), np.inf  # the first step is plain least squares, as the start may be far off
    for _ in range(STEPS):
        H, g, size = normal_equations(p_key, px_ideal, z_m, sigma_z_m, T, lens, SIGMA_PX, scale)
        seen = np.isfinite(size)
        if seen.sum() < least:
            return None
        scale = float(np.clip(1.5 * np.median(size[seen]), *SCALES_PX))
        if known:
            H, g = H + known.information, g + known.information @ _apart(T, known.T_cam_key)
        _, step, singular = dposv(H + 1e-9 * np.trace(H) * np.eye(6), -g)
        if singular:
            return None
        turn = se3.exp_so3(step[:3])
        T[:3, :3], T[:3, 3] = turn @ T[:3, :3], turn @ T[:3, 3] + step[3:]
        if np.abs(step).max() < SETTLED:
            break
    H, _, size = normal_equations(p_key, px_ideal, z_m, sigma_z_m, T, lens, SIGMA_PX, scale)
    agrees = size < FAR * scale
    if agrees.sum() < max(least, MIN_SHARE * len(size)) or not np.isfinite(T).all():
        return None
    information = H / (scale / SCALES_PX[0]) ** 2
    if known:
        if scale == SCALES_PX[1] or contradiction(T, known) > MAX_CHI2:
            return None
        information = information + known.information
    return Motion(T, information, agrees)


def contradiction(T: Floats, known: PartialMotion) -> float:
    """Squared distance of a motion T (4, 4) from what is known of it, in standard deviations."""
    off = _apart(T, known.T_cam_key)
    return float(off @ known.information @ off)


def _apart(T: Floats, other: Floats) -> Floats:
    """(w, v) with T = [exp(w) | v] other, both (4, 4)."""
    off = T @ se3.inverse(other)
    return np.concatenate([se3.log_so3(off[:3, :3]), off[:3, 3]])


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(
    p_key: Floats,
    px_ideal: Floats,
    z_m: Floats,
    sigma_z_m: Floats,
    T: Floats,
    lens: tuple[float, float, float, float],
    sigma_px: float,
    scale: float,
) -> tuple[Floats, Floats, Floats]:
    """H (6, 6), g (6,) by steps (w, v) of [exp(w) | v] T, and the size (n,) of each residual in sigmas.

    p_key (n, 3) m in the keyframe; px_ideal (n, 2) undistorted pixels, z_m and sigma_z_m (n,) in the frame; T (4, 4)
    from keyframe to frame. lens: fx fy cx cy. A Cauchy kernel of this `scale` on pixels, and on depth; infinity: none.
    The size is that of the pixels; NaN for a point behind the camera.
    """
    H, g, size = np.zeros((6, 6)), np.zeros(6), np.full(len(p_key), np.nan)
    J, r, w = np.zeros((3, 6)), np.zeros(3), np.zeros(3)
    for k in range(len(p_key)):
        a, b, c = p_key[k, 0], p_key[k, 1], p_key[k, 2]
        x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
        y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
        z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
        if z < NEAR_M:
            continue
        for i in range(2):
            f, q = lens[i] / (z * sigma_px), x if i == 0 else y
            r[i] = (lens[i] * q / z + lens[2 + i] - px_ideal[k, i]) / sigma_px
            s = q / z
            dx, dy, dz = (f, 0.0, -f * s) if i == 0 else (0.0, f, -f * s)
            J[i, 0], J[i, 1], J[i, 2] = dz * y - dy * z, dx * z - dz * x, dy * x - dx * y
            J[i, 3], J[i, 4], J[i, 5] = dx, dy, dz
        size[k] = np.sqrt(r[0] * r[0] + r[1] * r[1])
        w[0] = w[1] = 1.0 / (1.0 + (size[k] / scale) ** 2)
        w[2] = 0.0
        if z_m[k] > 0:
            r[2] = (z - z_m[k]) / sigma_z_m[k]
            J[2, 0], J[2, 1], J[2, 2] = y / sigma_z_m[k], -x / sigma_z_m[k], 0.0
            J[2, 3], J[2, 4], J[2, 5] = 0.0, 0.0, 1.0 / sigma_z_m[k]
            w[2] = 1.0 / (1.0 + (r[2] / scale) ** 2)
        for row in range(3):
            for i in range(6):
                weighted = w[row] * J[row, i]
                g[i] += weighted * r[row]
                for j in range(i + 1):
                    H[i, j] += weighted * J[row, j]
    for i in range(6):
        for j in range(i):
            H[j, i] = H[i, j]
    return H, g, size
