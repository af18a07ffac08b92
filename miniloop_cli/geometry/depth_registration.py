"""Depth as another camera would have measured it: the mesh of the depth image, drawn into the other image.

Neighbouring depth pixels of one surface span triangles. These are drawn with a z-buffer at the pixels of the other
camera. The result is sub-pixel exact on surfaces and has no holes where that camera has more pixels. It is empty where
the depth camera did not see, as no triangle spans a step in depth.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens_kernels import distort, lens_numbers
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats, Floats32

MAX_STEP = 0.03  # relative difference in depth of neighbouring pixels of one surface
MIN_Z_M = 1e-3


def register_depth(depth_m: Floats32, depth_camera: Camera, color_camera: Camera, T_color_depth: Floats) -> Floats32:
    """(h, w) depth (m, 0 = no reading) of `depth_camera` as (h', w') depth on the pixels of `color_camera`.

    T_color_depth: (4, 4), points of the depth camera to points of the colour camera, m. Both lenses are taken into
    account. 0 where nothing was measured, where the depth camera did not see, and at readings without neighbours.
    """
    rays = _rays(depth_camera)
    depth_m = np.ascontiguousarray(depth_m, np.float32)
    R, t = np.ascontiguousarray(T_color_depth[:3, :3]), np.ascontiguousarray(T_color_depth[:3, 3])
    px = np.empty((*depth_m.shape, 2))
    z = np.empty(depth_m.shape)
    K = np.array([color_camera.fx, color_camera.fy, color_camera.cx, color_camera.cy])
    _project(depth_m, rays, R, t, K, *lens_numbers(color_camera.lens), px, z)
    registered = np.zeros((color_camera.height, color_camera.width), np.float32)
    _draw_mesh(depth_m, px, z, registered)
    return registered


@lru_cache(maxsize=4)
def _rays(camera: Camera) -> Floats:
    """(h, w, 2) points on the plane z = 1 that the pixels of a camera see."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    ideal = camera.undistort(np.stack([u.ravel(), v.ravel()], axis=1))
    rays = (ideal - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    return np.ascontiguousarray(rays.reshape(camera.height, camera.width, 2))


@njit(cache=True, nogil=True, error_model="numpy")
def _project(
    depth_m: Floats32,
    rays: Floats,
    R: Floats,
    t: Floats,
    K: Floats,
    lens: int,
    c: Floats,
    limit: float,
    px: Floats,
    z: Floats,
) -> None:
    """Pixels (h, w, 2) and depths (h, w) of all readings in the other camera; depth 0 where there is none."""
    height, width = depth_m.shape
    for v in range(height):
        for u in range(width):
            d = depth_m[v, u]
            z[v, u] = 0.0
            if not d > 0.0:
                continue
            x, y = rays[v, u, 0] * d, rays[v, u, 1] * d
            zc = R[2, 0] * x + R[2, 1] * y + R[2, 2] * d + t[2]
            if zc < MIN_Z_M:
                continue
            a = (R[0, 0] * x + R[0, 1] * y + R[0, 2] * d + t[0]) / zc
            b = (R[1, 0] * x + R[1, 1] * y + R[1, 2] * d + t[1]) / zc
            a, b = distort(a, b, lens, c, limit)
            px[v, u, 0], px[v, u, 1] = K[0] * a + K[2], K[1] * b + K[3]
            z[v, u] = zc


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_mesh(depth_m: Floats32, px: Floats, z: Floats, out: Floats32) -> None:
    """Draw the triangles of every 2 x 2 pixels that lie on one surface; the nearest wins."""
    height, width = depth_m.shape
    for v in range(height - 1):
        for u in range(width - 1):
            # The shorter diagonal in depth divides the square, so that an edge through it costs one triangle only.
            first = abs(depth_m[v, u] - depth_m[v + 1, u + 1]) <= abs(depth_m[v, u + 1] - depth_m[v + 1, u])
            whole = depth_m[v, u] > 0 and depth_m[v + 1, u + 1] > 0 and depth_m[v, u + 1] > 0 and depth_m[v + 1, u] > 0
            if not whole:
                first = depth_m[v, u] > 0 and depth_m[v + 1, u + 1] > 0
            if first:
                _draw(depth_m, px, z, out, v, u, v, u + 1, v + 1, u + 1)
                _draw(depth_m, px, z, out, v, u, v + 1, u + 1, v + 1, u)
            else:
                _draw(depth_m, px, z, out, v, u, v, u + 1, v + 1, u)
                _draw(depth_m, px, z, out, v, u + 1, v + 1, u + 1, v + 1, u)


@njit(cache=True, nogil=True, error_model="numpy")
def _draw(
    depth_m: Floats32, px: Floats, z: Floats, out: Floats32, va: int, ua: int, vb: int, ub: int, vc: int, uc: int
) -> None:
    """One triangle, its corners clockwise in the image, at the pixel centres that it covers."""
    za, zb, zc = z[va, ua], z[vb, ub], z[vc, uc]
    if not (za > 0.0 and zb > 0.0 and zc > 0.0):
        return
    da, db, dc = depth_m[va, ua], depth_m[vb, ub], depth_m[vc, uc]
    near = min(da, db, dc)
    if max(da, db, dc) - near > MAX_STEP * near:
        return
    xa, ya, xb, yb, xc, yc = px[va, ua, 0], px[va, ua, 1], px[vb, ub, 0], px[vb, ub, 1], px[vc, uc, 0], px[vc, uc, 1]
    area = (xb - xa) * (yc - ya) - (yb - ya) * (xc - xa)
    if not area > 1e-12:  # seen from behind, or beyond the lens (NaN)
        return
    height, width = out.shape
    left, right = min(xa, xb, xc), max(xa, xb, xc)
    top, bottom = min(ya, yb, yc), max(ya, yb, yc)
    if right < -0.5 or bottom < -0.5 or left > width or top > height or right - left > 64 or bottom - top > 64:
        return
    slack = 1e-9 * (1.0 + area)
    for y in range(max(int(np.ceil(top - 1e-6)), 0), min(int(np.floor(bottom + 1e-6)), height - 1) + 1):
        for x in range(max(int(np.ceil(left - 1e-6)), 0), min(int(np.floor(right + 1e-6)), width - 1) + 1):
            a = (xb - x) * (yc - y) - (yb - y) * (xc - x)
            b = (xc - x) * (ya - y) - (yc - y) * (xa - x)
            c = area - a - b
            if a < -slack or b < -slack or c < -slack:
                continue
            depth = area / (a / za + b / zb + c / zc)  # the inverse of depth is linear in the image
            if out[y, x] == 0.0 or depth < out[y, x]:
                out[y, x] = depth
