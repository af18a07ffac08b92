"""Depth on single rays of a colour camera, read from the image of a separate depth camera."""

from __future__ import annotations

import numpy as np

from miniloop_cli.config import Depth
from miniloop_cli.features.keypoints3d import SLOPE_STEP_PX, depth_at, smooth_slope
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
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
    """Depths (k,) m at which the rays meet the measured surface, by iteration from `near_m` (k,) or a usual depth.

    A guess of the depth gives a position in the depth image; the reading there is the next guess. On a surface that
    both cameras see this converges at once, as the position changes little with the depth.
    """
    some = depth_m[::8, ::8]
    readings = some[some > 0]
    usual_m = float(np.median(readings)) if len(readings) else 1.0
    T = se3.inverse(own.T_color_depth)
    rays = color.backproject(color.undistort(px), np.ones(len(px)))
    turned, shift = rays @ T[:3, :3].T, T[:3, 3]
    z_m = np.full(len(px), usual_m) if near_m is None else np.where(np.isfinite(near_m), near_m, usual_m)
    found = np.zeros(len(px), bool)
    for _ in range(STEPS):
        X = z_m[:, None] * turned + shift
        ahead = X[:, 2] > settings.min_m / 2
        seen = own.camera.distort(own.camera.project(np.where(ahead[:, None], X, 1.0)))
        inside = ahead & np.isfinite(seen).all(axis=1)
        read = depth_at(depth_m, np.where(inside[:, None], seen, -1.0), settings)
        reading = np.isfinite(read)
        # Without a reading, beside an edge or in a hole, the guess is kept: the next step may leave the hole.
        after = np.where(reading, (np.nan_to_num(read) - shift[2]) / turned[:, 2], z_m)
        found = reading & (np.abs(after - z_m) < AGREES * z_m)
        z_m = np.where(after > 0, after, z_m)
    return np.where(found, z_m, np.nan)
