"""Timing of a moving RGB-D camera: rolling shutter, and depth that lags behind colour.

The rows of a colour image are exposed one after the other, and its depth image was taken at another time. With a known
motion of the camera, the measurements are corrected for both: a pixel moves to its position at the time of the middle
row, and a depth becomes the depth at that time. The two times are constant over a recording; they are estimated as
those of least cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Floats, Ints

if TYPE_CHECKING:  # a run with refined poses in the cache does not import the bundle adjustment
    from miniloop_cli.refinement.bundle import BundleResult


@dataclass(frozen=True)
class Measurements:
    """Observations of tracks as they were made, k of them.

    frame, track (k,); row_share (k,) place of the measured row in the image, -1/2 at the top to 1/2 at the bottom;
    px_ideal (k, 2); z_m (k,) or NaN; slope (k, 2) m/px; stamp_lag_s (k,) depth stamp minus colour stamp.
    """

    frame: Ints
    track: Ints
    row_share: Floats
    px_ideal: Floats
    z_m: Floats
    slope: Floats
    stamp_lag_s: Floats

    def subset(self, rows: NDArray) -> Measurements:
        """The measurements of these rows (indices or a mask)."""
        return Measurements(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Flow:
    """Points X (k, 3) in cameras that turn by w (k, 3) rad/s and move by v (k, 3) m/s, all in the camera's frame.

    The velocity of their images: px (k, 2) in px/s, and of their depths: z (k,) in m/s.
    """

    X: Floats
    v: Floats
    w: Floats
    px: Floats
    z: Floats


def flow(measured: Measurements, depth_m: Floats, v: Floats, w: Floats, camera: Camera) -> Flow:
    """Motion in the image of points at the measured pixels and `depth_m` (k,), for a camera with twists v, w (n, 3)."""
    X, v, w = camera.backproject(measured.px_ideal, depth_m), v[measured.frame], w[measured.frame]
    X_dot = -v - np.cross(w, X)
    px = np.stack(
        [
            camera.fx * (X_dot[:, 0] - X[:, 0] / X[:, 2] * X_dot[:, 2]) / X[:, 2],
            camera.fy * (X_dot[:, 1] - X[:, 1] / X[:, 2] * X_dot[:, 2]) / X[:, 2],
        ],
        axis=1,
    )
    return Flow(X, v, w, px, X_dot[:, 2])


def corrected(measured: Measurements, moving: Flow, timing: Timing, camera: Camera) -> tuple[Floats, Floats]:
    """Pixels (k, 2) and depths (k,) as if the whole frame had been taken at its colour stamp's middle row.

    The pixel was measured at the time e of its row, the depth there d later, as infrared cameras have rolling shutters
    as well. The ray of the pixel, in the camera of the middle row, meets the point's depth at `scale` along the ray. In
    the time d the image moves over the surface by d flow, and the depth changes by d z':
    z(stamp) = z + d slope . flow - d z' + (z(middle row) - z(row)). Where that is behind the camera, the motion is
    wrong, and the depth is NaN.
    """
    row_s, late_s = timing.readout_s * measured.row_share, measured.stamp_lag_s + timing.lag_s
    turn, move = row_s[:, None] * moving.w, row_s[:, None] * moving.v
    depth_m = moving.X[:, 2]
    X = moving.X + np.cross(turn, moving.X + np.cross(turn, moving.X) / 2)  # to second order: 0.003 px at 200 deg/s
    scale = (depth_m - move[:, 2]) / np.maximum(X[:, 2], 0.1 * depth_m)  # a seen point stays in front of the camera
    X = scale[:, None] * X + move
    X[:, 2] = depth_m
    z_m = measured.z_m + late_s * (_along_surface(measured, moving) - moving.z) + (1 - scale) * depth_m
    return camera.project(X), np.where(z_m > 0, z_m, np.nan)


def _along_surface(measured: Measurements, moving: Flow) -> Floats:
    """Change of the depth read (k,) m/s, where the image moves over the surface."""
    return np.einsum("ki,ki->k", measured.slope, moving.px)


def slopes(
    measured: Measurements, moving: Flow, adjusted: BundleResult, sigma_px: float, sigma_z_m: Floats
) -> tuple[Floats, Floats]:
    """First and second derivatives (2,) of the cost of an adjustment of the measurements by readout_s and lag_s.

    At a minimum over poses and points, the first are total derivatives: the effect of poses and points that follow
    vanishes to first order. The second are for fixed poses and points.
    """
    with_depth = np.isfinite(adjusted.residual_depth)
    px_by_readout = moving.px * measured.row_share[:, None] / sigma_px
    z_by_readout = np.where(with_depth, measured.row_share * moving.z / sigma_z_m, 0.0)
    z_by_lag = np.where(with_depth, (moving.z - _along_surface(measured, moving)) / sigma_z_m, 0.0)
    w_px, w_z = adjusted.weight_px[:, None], adjusted.weight_depth
    # Residuals are predicted minus measured, in sigmas.
    r_px, r_z = w_px * np.nan_to_num(adjusted.residual_px), w_z * np.nan_to_num(adjusted.residual_depth)
    # Sums instead of matrix products, whose last bits depend on the alignment of an array in memory.
    first = [(r_px * px_by_readout).sum() + (r_z * z_by_readout).sum(), (r_z * z_by_lag).sum()]
    second = [(w_px * px_by_readout**2).sum() + (w_z * z_by_readout**2).sum(), (w_z * z_by_lag**2).sum()]
    return np.array(first), np.array(second)


def camera_depths(measured: Measurements, T_world_cam: Floats, points_world: Floats) -> Floats:
    """Depth (k,) of each observation's point in its camera; the measured depth where the point is not known.

    Poses T_world_cam (n, 4, 4), points_world (p, 3) m, NaN where not known.
    """
    X = points_world[measured.track]
    T = se3.inverse(T_world_cam)[measured.frame]
    z = np.einsum("ki,ki->k", T[:, 2, :3], X) + T[:, 2, 3]
    usable = np.isfinite(z) & (z > 0.05)
    return np.where(usable, z, np.where(np.isfinite(measured.z_m), measured.z_m, 2.0))
