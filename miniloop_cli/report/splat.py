"""A picture of a coloured cloud, without a graphics card: points as squares, nearest first, edges shaded by depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.geometry import se3
from miniloop_cli.typing import Bytes, Floats, Floats32

BACKGROUND = np.array([250, 250, 250], np.uint8)
NEAR_M = 0.05
LARGEST_PX = 6


@dataclass(frozen=True)
class View:
    """A pinhole camera: T_view_world, focal length (px) and picture size (px)."""

    T_view_world: Floats
    focal_px: float
    width: int = 960
    height: int = 640

    def project(self, points_world: NDArray[np.floating]) -> tuple[Floats32, Floats32]:
        """(n, 3) points to (n, 2) pixels and (n,) depths (m); depths at most 0 are behind the view."""
        T = self.T_view_world.astype(np.float32)  # precise enough for pixels, and faster
        p: Floats32 = np.asarray(points_world, np.float32) @ np.ascontiguousarray(T[:3, :3].T) + T[:3, 3]
        z: Floats32 = np.where(p[:, 2] > NEAR_M, p[:, 2], np.float32(np.nan))
        centre = np.array([(self.width - 1) / 2, (self.height - 1) / 2], np.float32)
        return np.float32(self.focal_px) * p[:, :2] / z[:, None] + centre, p[:, 2]


def overview(
    points: NDArray[np.floating], T_world_cam: Floats, yaw_deg: float, pitch_deg: float, view: tuple[int, int]
) -> View:
    """A view of points (p, 3), rotated from the mean direction of the cameras (n, 4, 4) about their mean vertical.

    The 3rd to 97th percentile of the points fits the picture, so a few stray points do not make it small.
    """
    R_mean = se3.project_so3(T_world_cam[:, :3, :3].sum(axis=0))
    turn = se3.exp_so3(np.radians([0, yaw_deg, 0])) @ se3.exp_so3(np.radians([-pitch_deg, 0, 0]))
    R_view_world = (R_mean @ turn).T
    p = points[:: 1 + len(points) // 100_000] @ R_view_world.T
    low, high = np.percentile(p, [3, 97], axis=0)
    centre, half = (low + high) / 2, (high - low) / 2
    width, height = view
    focal = 1.1 * width
    # Far enough that the box fits: its front face, at depth d - half_z, must lie within the picture's half angles.
    distance = half[2] + 1.08 * max(half[0] * focal / (width / 2), half[1] * focal / (height / 2), 0.1)
    return View(se3.pose(R_view_world, np.array([0, 0, distance]) - centre), focal, width, height)


def render(points: NDArray[np.floating], colors: Bytes, view: View, point_m: float = 0.016) -> Bytes:
    """(h, w, 3) picture of (n, 3) points with (n, 3) colours, drawn as squares of `point_m` metres (1 to 6 px)."""
    px, z = view.project(points)
    side = np.clip(np.ceil(view.focal_px * point_m / np.maximum(z, NEAR_M)), 1, LARGEST_PX)
    corner = np.floor(px - (side[:, None] - 1) / 2 + 0.5)
    # The canvas has a margin of the largest square, so that no square needs clipping.
    stride, canvas = view.width + 2 * LARGEST_PX, (view.height + 2 * LARGEST_PX) * (view.width + 2 * LARGEST_PX)
    size = np.array([view.width, view.height])
    rows = np.flatnonzero((z > NEAR_M) & (corner > -LARGEST_PX).all(axis=1) & (corner < size).all(axis=1))
    rows = rows[np.argsort(-z[rows], kind="stable")]  # far to near, so that the nearest is written last
    z, side = z[rows], side[rows].astype(np.int8)
    at = ((corner[rows] + LARGEST_PX) @ [1, stride]).astype(np.int32)
    winner, order = np.full(canvas, -1, np.int32), np.arange(len(rows), dtype=np.int32)
    for extent in range(int(side.max(initial=0))):
        larger = side > extent
        order, at, side = order[larger], at[larger], side[larger]
        for dx, dy in [(extent, k) for k in range(extent + 1)] + [(k, extent) for k in range(extent)]:
            pixels = at + np.int32(dx + dy * stride)
            winner[pixels] = np.maximum(winner[pixels], order)  # for equal pixels, the largest (last) remains
    winner = winner.reshape(-1, stride)[LARGEST_PX:-LARGEST_PX, LARGEST_PX:-LARGEST_PX]
    if not len(rows):
        return np.broadcast_to(BACKGROUND, (view.height, view.width, 3)).copy()
    drawn = winner >= 0
    depth = np.where(drawn, z[winner], np.float32(np.inf))
    return shade(np.where(drawn[..., None], colors[rows[winner]], BACKGROUND), depth)


def shade(picture: Bytes, depth: Floats32) -> Bytes:
    """Darken pixels that lie behind their neighbours (eye-dome lighting, Boucheny 2009): shape shows at once.

    picture (h, w, 3), depth (h, w), not finite where nothing is.
    """
    log_depth = np.log(np.where(np.isfinite(depth), depth, np.nan))
    behind = np.zeros(depth.shape, depth.dtype)
    for axis in (0, 1):
        for shift in (-2, 2):
            difference = log_depth - np.roll(log_depth, shift, axis)
            behind += np.clip(np.nan_to_num(difference), 0, 0.1)
    return np.rint(picture * np.exp(-2.5 * behind)[:, :, None]).astype(np.uint8)
