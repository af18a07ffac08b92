"""Depth on single rays of a colour camera, read from the image of a separate depth camera."""

from __future__ import annotations

import numpy as np

from miniloop_cli.config import Depth
from miniloop_cli.features.keypoints3d import SLOPE_STEP_PX, smooth_slope
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens_kernels import distort, lens_numbers
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.sequence import DepthCamera
from miniloop_cli.typing import Floats, Floats32

STEPS = 5
AGREES = 0.01  # relative change of a depth at which the search has converged


def depth_on_rays(
    depth_m: Floats32, px: Floats, color: Camera, own: DepthCamera, settings: Depth
) -> tuple[Floats, Floats]:
    """Depths (k,) m or NaN along the rays of measured pixels (k, 2) of colour, and slopes (k, 2) m/px around them.

    depth_m (h, w): as the depth camera measured it, 0 = no reading. The same as registering the whole image
    (geometry/depth_registration.py) where one surface is seen by both cameras; NaN beside edges.
    """
    z_m = _on_rays(depth_m, px, color, own, settings)
    slope = np.zeros((len(px), 2))
    for axis in range(2):
        step = np.eye(2)[axis] * SLOPE_STEP_PX
        before, after = (_on_rays(depth_m, px + sign * step, color, own, settings, z_m) for sign in (-1, 1))
        slope[:, axis] = smooth_slope(before, z_m, after)
    return z_m, slope


def _on_rays(
    depth_m: Floats32, px: Floats, color: Camera, own: DepthCamera, settings: Depth, near_m: Floats | None = None
) -> Floats:
    """Depths (k,) m or NaN where the rays meet the measured surface, by iteration from `near_m` (k,) or a usual depth.

    A guess of the depth gives a position in the depth image; the reading there is the next guess. On a surface that
    both cameras see this converges at once, as the position changes little with the depth.
    """
    some = depth_m[::8, ::8]
    readings = some[some > 0]
    usual_m = float(np.median(readings)) if len(readings) else 1.0
    z_m = np.full(len(px), usual_m) if near_m is None else np.where(np.isfinite(near_m), near_m, usual_m)
    T = se3.inverse(own.T_color_depth)
    rays = np.ascontiguousarray(color.backproject(color.undistort(px), np.ones(len(px))) @ T[:3, :3].T)
    camera = own.camera
    K = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    limits = np.array([settings.min_m, settings.max_m, settings.edge_ratio])
    _look(depth_m, rays, np.ascontiguousarray(T[:3, 3]), K, *lens_numbers(camera.lens), limits, z_m)
    return z_m


@njit(cache=True, nogil=True, error_model="numpy")
def _look(
    depth_m: Floats32,
    rays: Floats,
    shift: Floats,
    K: Floats,
    lens: int,
    c: Floats,
    limit: float,
    limits: Floats,
    z_m: Floats,
) -> None:
    """Guesses z_m (k,) become the depths along rays (k, 3) from `shift` (3,), in the frame of the depth camera, or NaN.

    K: fx fy cx cy px and lens of the depth camera. limits: smallest and largest depth (m), and edge_ratio.
    """
    for k in range(len(z_m)):
        x, y, z = rays[k, 0], rays[k, 1], rays[k, 2]
        guess, found = z_m[k], False
        for _ in range(STEPS):
            read = np.nan
            ahead = guess * z + shift[2]
            if ahead > limits[0] / 2:
                a, b = distort((guess * x + shift[0]) / ahead, (guess * y + shift[1]) / ahead, lens, c, limit)
                read = depth_at_point(depth_m, K[0] * a + K[2], K[1] * b + K[3], limits)
            found = False
            if not read > 0.0:  # beside an edge, in a hole, or outside of the image
                break
            after = (read - shift[2]) / z
            if not after > 0.0:
                break
            found = abs(after - guess) < AGREES * guess
            guess = after
        z_m[k] = guess if found else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def depth_at_point(depth_m: Floats32, u: float, v: float, limits: Floats) -> float:
    """`keypoints3d.depth_at` of one pixel in depth_m (h, w); limits (3,) as in `_look`."""
    height, width = depth_m.shape
    if not (u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1):
        return np.nan
    x, y = int(u), int(v)
    fx, fy = u - x, v - y
    above, beside = float(depth_m[y, x]), float(depth_m[y, x + 1])
    below, across = float(depth_m[y + 1, x]), float(depth_m[y + 1, x + 1])
    if not (above > 0.0 and beside > 0.0 and below > 0.0 and across > 0.0):
        return np.nan
    near, far = min(above, beside, below, across), max(above, beside, below, across)
    if not far - near <= limits[2] * near:
        return np.nan
    value = above * (1 - fx) * (1 - fy) + beside * fx * (1 - fy) + below * (1 - fx) * fy + across * fx * fy
    return value if limits[0] <= value <= limits[1] else np.nan
