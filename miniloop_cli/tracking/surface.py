"""The motion between two frames from depth and brightness, for frames without tracked points.

Depth is compared point to plane (Chen & Medioni 1992), brightness directly (Steinbruecker, Sturm & Cremers 2011), both
on a small ideal image. A wall does not determine two translations and a rotation; the information shows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from miniloop_cli.config import Depth
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.partial_motion import without_open
from miniloop_cli.scene.sequence import Scan
from miniloop_cli.typing import Bytes, Floats, Floats32

COLUMNS = 160
SMOOTH, NORMAL_STEP = 2, 4  # cells to each side: for the mean of points, and for the differences that give normals
MAX_SLOPE, MIN_VALID = 0.2, 0.7  # largest relative change of depth within a surface; smallest share of readings there
STEPS = 20
DEPTH_SIGMA_FACTOR, SIGMA_GRAY = 2.0, 8.0
CAUCHY2 = 4.0  # squared scale of the kernels, in sigmas
MAX_JUMP_SHARE, MAX_JUMP_M = 0.03, 0.06  # of depth: with more, two cells are not of one surface
SHARED_CELLS = 20.0  # so many neighbouring cells count as one, as they share their errors
PRIOR_RAD, PRIOR_M = 0.04, 0.04  # standard deviations of the predicted motion
MAX_PRIOR_CHI2 = 16.0  # motions farther from it are rejected
MIN_OVERLAP, MIN_FITTING = 0.3, 0.8  # of the cells with depth; and of those compared, within three sigmas
LEAST_SHARE = (
    0.002  # of the best direction's information: less comes from the noise of normals, which gives up to 0.001
)
MIN_SLOPE_SIGMAS, ROUNDING_GRAY = 3.0, 0.3  # one of 8,000 slopes of noise is larger; noise of whole gray levels
SETTLED = 1e-5


@dataclass(frozen=True)
class Surface:
    """A frame on an ideal pinhole grid: points (h, w, 3) m, NaN without depth; normals (h, w, 3); gray (h, w).

    slopes (h, w, 2) of gray along u and v, per cell; zero where noise can be their cause. lens: fx fy cx cy of the
    grid; sigma_m (h, w) of depth.
    """

    points: Floats
    normals: Floats
    gray: Floats
    slopes: Floats
    sigma_m: Floats
    lens: tuple[float, float, float, float]


class SurfaceMotion(NamedTuple):
    """T_cam_key (4, 4), information (6, 6) as in Motion, zero in open directions; share of this frame's cells seen in
    both; cells that fit."""

    T_cam_key: Floats
    information: Floats
    overlap: float
    cells: int


@cache
def _grid(camera: Camera) -> tuple[Floats32, Floats32, tuple[float, float, float, float]]:
    """Positions x and y (h, w) of the cells of the ideal grid in the measured image; and the grid's own lens."""
    scale = COLUMNS / camera.width
    rows = round(camera.height * scale)
    v, u = np.mgrid[0:rows, 0:COLUMNS]
    px = camera.distort(np.stack([u.ravel(), v.ravel()], axis=1) / scale)
    x, y = np.nan_to_num(px, nan=-1e4).astype(np.float32).T
    lens = (camera.fx * scale, camera.fy * scale, camera.cx * scale, camera.cy * scale)
    return x.reshape(rows, COLUMNS), y.reshape(rows, COLUMNS), lens


def make_surface(scan: Scan, gray: Bytes, camera: Camera, depth: Depth) -> Surface:
    """The surface of a scan, whose brightness is gray (h, w)."""
    import cv2

    x, y, lens = _grid(camera)
    z = np.asarray(cv2.remap(scan.depth_m, x, y, cv2.INTER_NEAREST), float)
    z[~((z >= depth.min_m) & (z <= depth.max_m))] = np.nan
    blur = cv2.getGaussianKernel(2 * round(2 * camera.width / COLUMNS) + 1, camera.width / COLUMNS / 2)
    smooth = cv2.sepFilter2D(gray, cv2.CV_32F, blur, blur)
    brightness = np.asarray(cv2.remap(smooth, x, y, cv2.INTER_LINEAR), float)
    slopes = _slopes(brightness, _noise(gray) * float((blur**2).sum()))
    v, u = np.mgrid[0 : z.shape[0], 0 : z.shape[1]]
    points = np.stack([(u - lens[2]) / lens[0] * z, (v - lens[3]) / lens[1] * z, z], axis=2)
    sigma_m = DEPTH_SIGMA_FACTOR * camera.noise.sigma_m(np.nan_to_num(z, nan=1.0))
    return Surface(points, _normals(points), brightness, slopes, sigma_m, lens)


def _noise(gray: Bytes) -> float:
    """Standard deviation of the noise of single pixels of an image (h, w): Immerkaer (1996), by the median.

    What is left when a quadratic surface is taken away from 3 x 3 pixels; in most places that is little else.
    """
    import cv2

    left = cv2.filter2D(gray, cv2.CV_16S, np.outer([1, -2, 1], [1, -2, 1]))
    return max(float(np.median(np.abs(left[::3, ::3]))) / 0.6745 / 6, ROUNDING_GRAY)


def _slopes(gray: Floats, sigma_gray: float) -> Floats:
    """Slopes (h, w, 2) of gray (h, w) per cell along u and v; zero where noise of sigma_gray can be their cause.

    The slopes of noise would count as information on all directions, also before a bare wall.
    """
    slopes = np.zeros((*gray.shape, 2))
    slopes[:, 1:-1, 0] = (gray[:, 2:] - gray[:, :-2]) / 2
    slopes[1:-1, :, 1] = (gray[2:] - gray[:-2]) / 2
    slopes[(slopes**2).sum(axis=2) < (MIN_SLOPE_SIGMAS * sigma_gray) ** 2] = 0
    return slopes


def _normals(points: Floats) -> Floats:
    """Unit normals (h, w, 3) by differences across cells of smoothed surfaces; NaN at their edges.

    Noise of the normals would add false information in directions that the surface does not determine.
    """
    import cv2

    size, s = (2 * SMOOTH + 1, 2 * SMOOTH + 1), NORMAL_STEP
    valid = np.isfinite(points[..., 2]).astype(float)
    share = np.asarray(cv2.blur(valid, size), float)
    smooth = np.asarray(cv2.blur(np.nan_to_num(points), size), float) / np.maximum(share, 1e-3)[..., None]
    z = np.where(valid > 0, points[..., 2], 0)
    square = np.ones((2 * (s + SMOOTH) + 1,) * 2, np.uint8)
    far = np.asarray(cv2.dilate(z, square), float)
    near = np.asarray(cv2.erode(np.where(valid > 0, z, np.inf), square), float)
    normals = np.full_like(points, np.nan)
    along_x = smooth[s:-s, 2 * s :] - smooth[s:-s, : -2 * s]
    along_y = smooth[2 * s :, s:-s] - smooth[: -2 * s, s:-s]
    n = np.cross(along_x, along_y)
    n /= np.maximum(np.linalg.norm(n, axis=2, keepdims=True), 1e-12)
    one = (far - near < MAX_JUMP_M + MAX_SLOPE * z)[s:-s, s:-s] & (share[s:-s, s:-s] > MIN_VALID)
    normals[s:-s, s:-s] = np.where(one[..., None], n, np.nan)
    return normals


def surface_motion(
    key: Surface,
    now: Surface,
    T_cam_key: Floats,
    min_overlap: float = MIN_OVERLAP,
    min_fitting: float = MIN_FITTING,
) -> SurfaceMotion | None:
    """The motion between two surfaces, by a search near T_cam_key (4, 4); None if they do not fit each other."""
    prior = np.diag([PRIOR_RAD**-2.0] * 3 + [PRIOR_M**-2.0] * 3)
    T, moved = se3.inverse(T_cam_key), np.zeros(6)
    offset = 0.0
    for _ in range(STEPS):
        H, g, seen, _, _, offset = _equations(
            key.points, key.normals, key.gray, key.slopes, now.points, now.gray, now.sigma_m, key.lens, T, offset
        )
        if seen < 100:
            return None
        step = -np.linalg.solve(H / SHARED_CELLS + prior, g / SHARED_CELLS + prior @ moved)
        T = se3.pose(se3.exp_so3(step[:3]), step[3:]) @ T
        moved += step
        if np.abs(step).max() < SETTLED:
            break
    H, _, seen, compared, fitting, _ = _equations(
        key.points, key.normals, key.gray, key.slopes, now.points, now.gray, now.sigma_m, key.lens, T, offset
    )
    overlap = seen / max(int(np.isfinite(now.points[..., 2]).sum()), 1)
    astray = not moved @ prior @ moved < MAX_PRIOR_CHI2  # also where it is NaN
    if overlap < min_overlap or fitting < min_fitting * compared or astray:
        return None
    found = se3.inverse(T)
    back = np.linalg.inv(se3.adjoint(found))
    information = without_open(back.T @ (H / SHARED_CELLS) @ back, LEAST_SHARE)
    return SurfaceMotion(found, information, float(overlap), int(fitting))


@njit(cache=True, nogil=True, error_model="numpy")
def _equations(
    p_key: Floats,
    n_key: Floats,
    gray_key: Floats,
    slopes_key: Floats,
    p_now: Floats,
    gray_now: Floats,
    sigma_m: Floats,
    lens: tuple[float, float, float, float],
    T: Floats,
    offset: float,
) -> tuple[Floats, Floats, int, int, int, float]:
    """H (6, 6), g (6,) by steps (w, v) of [exp(w) | v] T_key_cam; cells compared, those that fit, brightness offset.

    Depth point to plane, brightness by the key's gradient, each under a Cauchy kernel. A cell fits where both do. The
    offset is by how much this frame is brighter, on average.
    """
    H, g, J, total = np.zeros((6, 6)), np.zeros(6), np.zeros(6), 0.0
    seen, compared, fitting = 0, 0, 0
    rows, columns = p_now.shape[0], p_now.shape[1]
    for v in range(rows):
        for u in range(columns):
            z0 = p_now[v, u, 2]
            if not z0 > 0:
                continue
            a, b = p_now[v, u, 0], p_now[v, u, 1]
            x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * z0 + T[0, 3]
            y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * z0 + T[1, 3]
            z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * z0 + T[2, 3]
            if z < 0.05:
                continue
            px, py = lens[0] * x / z + lens[2], lens[1] * y / z + lens[3]
            i, j = int(np.floor(py + 0.5)), int(np.floor(px + 0.5))
            if i < 1 or j < 1 or i >= rows - 1 or j >= columns - 1:
                continue
            zk = p_key[i, j, 2]
            if not zk > 0 or abs(zk - z) > MAX_JUMP_M + MAX_JUMP_SHARE * z:
                continue
            seen += 1
            n0, n1, n2 = n_key[i, j, 0], n_key[i, j, 1], n_key[i, j, 2]
            if not np.isfinite(n0):
                continue
            compared += 1
            sigma = sigma_m[v, u]
            r = (n0 * (x - p_key[i, j, 0]) + n1 * (y - p_key[i, j, 1]) + n2 * (z - zk)) / sigma
            J[0], J[1], J[2] = (y * n2 - z * n1) / sigma, (z * n0 - x * n2) / sigma, (x * n1 - y * n0) / sigma
            J[3], J[4], J[5] = n0 / sigma, n1 / sigma, n2 / sigma
            w = 1.0 / (1.0 + r * r / CAUCHY2)
            fits = abs(r) < 3.0
            for k in range(6):
                g[k] += w * J[k] * r
                for m in range(6):
                    H[k, m] += w * J[k] * J[m]
            gx, gy = slopes_key[i, j, 0], slopes_key[i, j, 1]
            expected = gray_key[i, j] + gx * (px - j) + gy * (py - i)
            total += gray_now[v, u] - expected
            r = (expected + offset - gray_now[v, u]) / SIGMA_GRAY
            fitting += fits and abs(r) < 3.0
            dx, dy = gx * lens[0] / z / SIGMA_GRAY, gy * lens[1] / z / SIGMA_GRAY
            dz = -(dx * x + dy * y) / z
            J[0], J[1], J[2] = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
            J[3], J[4], J[5] = dx, dy, dz
            w = 1.0 / (1.0 + r * r / CAUCHY2)
            for k in range(6):
                g[k] += w * J[k] * r
                for m in range(6):
                    H[k, m] += w * J[k] * J[m]
    return H, g, seen, compared, fitting, total / max(compared, 1)
