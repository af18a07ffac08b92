"""Visibility of the surface in a view: the triangle at every pixel, and the quality at each vertex."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from miniloop_cli.export.mesh_model import Mesh, vertex_normals
from miniloop_cli.export.texture.views import density, looked_at
from miniloop_cli.export.undistort import imaged
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import Scan
from miniloop_cli.typing import Bools, Floats, Floats32, Ints

MOST_WIDE = 320  # rays a row: enough for triangles of a centimetre
EDGE_PX = 8.0  # within so many pixels of a depth edge, colours may be those of the other side
EDGE_M, EDGE_SHARE = 0.03, 0.03  # a step of depth that is an edge: metres, and share of the depth
AGREE_M, AGREE_SHARE = 0.03, 0.03  # largest difference between measured depth and surface
GRAZING = 5.0  # tangent of the steepest angle at which a surface is seen
NORMAL_ROUNDS = 3
RIM_PX = 3  # along the border of the area that the lens images
NOTHING = np.uint32(0xFFFFFFFF)  # Open3D's number for no triangle


@dataclass(frozen=True)
class Hits:
    """Intersections of a grid of (h, w) rays: depth (m, inf = none), triangle (-1 = none), its barycentric u and v.

    Ray (i, j) goes through pixel (j, i) * step of the image.
    """

    depth_m: Floats32
    triangle: NDArray[np.int32]
    uv: Floats32
    step: float


@dataclass(frozen=True)
class Shown:
    """Vertices (k,) visible in a view, their (k, 2) pixels, and their quality (k,).

    Quality is pixels a square metre; 0 where the image is not to be used.
    """

    vertex: Ints
    px: Floats32
    quality: Floats32


class Sight:
    """A mesh and a camera that looks at it. Rays are cast by Open3D (Embree)."""

    def __init__(self, o3d: ModuleType, mesh: Mesh, camera: Camera, voxel_m: float) -> None:
        self.mesh, self.camera, self.voxel_m = mesh, camera, voxel_m
        self._imaged = cv2.erode(imaged(camera).astype(np.uint8), np.ones((2 * RIM_PX + 1,) * 2, np.uint8)) > 0
        self._core = o3d.core
        self._scene: Any = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor(np.ascontiguousarray(mesh.vertices, np.float32)),
            o3d.core.Tensor(np.ascontiguousarray(mesh.triangles, np.uint32)),
        )
        self._step = max(1.0, camera.width / MOST_WIDE)
        w, h = int((camera.width - 1) / self._step) + 1, int((camera.height - 1) / self._step) + 1
        u, v = np.meshgrid(np.arange(w) * self._step, np.arange(h) * self._step)
        px = np.stack([u.ravel(), v.ravel()], axis=1)
        self._rays = camera.backproject(px, np.ones(len(px))).reshape(h, w, 3).astype(np.float32)

    def hits(self, T_world_cam: Floats) -> Hits:
        """First intersections of the rays through all pixels at T_world_cam (4, 4); depths are along the axis."""
        T = T_world_cam.astype(np.float32)
        rays = np.empty((*self._rays.shape[:2], 6), np.float32)
        rays[..., :3], rays[..., 3:] = T[:3, 3], self._rays @ T[:3, :3].T
        found = self._scene.cast_rays(self._core.Tensor(rays))
        number = found["primitive_ids"].numpy()
        triangle = np.where(number == NOTHING, -1, number.astype(np.int64)).astype(np.int32)
        return Hits(found["t_hit"].numpy(), triangle, found["primitive_uvs"].numpy(), self._step)

    def quality(self, T_world_cam: Floats, scan: Scan, hits: Hits, normals: Floats32) -> Shown:
        """The quality of each vertex in the view from T_world_cam (4, 4); normals (n, 3).

        A vertex is hidden if it is behind the first surface, or if the measured depth differs: then something moved or
        is not in the model. Near an edge of depth the quality is low.
        """
        rows, px, z, cosine = looked_at(self.mesh.vertices, normals, T_world_cam, self.camera)
        u, v = np.rint(px / hits.step).astype(np.int64).T
        slack_m = np.float32(2 * self.voxel_m) + np.float32(GRAZING * hits.step / self.camera.fx) * z
        open_ = np.abs(hits.depth_m[v, u] - z) < slack_m
        u_px, v_px = np.rint(px).astype(np.int64).T
        measured = scan.depth_m[v_px, u_px]
        sure = open_ & self._imaged[v_px, u_px]
        sure &= (measured == 0) | (np.abs(measured - z) < AGREE_M + AGREE_SHARE * z)
        quality = np.where(sure, density(z, cosine, self.camera) * edge_factor(hits)[v, u], 0)
        return Shown(rows[open_], px[open_], quality[open_].astype(np.float32))


def smooth_normals(mesh: Mesh, smooth: csr_array) -> Floats32:
    """(n, 3) normals as means over neighbours, by `averaging`, as those of single vertices are noisy."""
    normals = vertex_normals(mesh)
    for _ in range(NORMAL_ROUNDS):
        normals = smooth @ normals
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.float32(1e-6))


def edge_factor(hits: Hits) -> Floats32:
    """(h, w) in (0, 1]: distance of each ray from the next edge of depth, or from rays without intersection."""
    depth = np.where(np.isfinite(hits.depth_m), hits.depth_m, np.float32(1e3))
    window = np.ones((3, 3), np.uint8)
    near, far = cv2.erode(depth, window), cv2.dilate(depth, window)
    flat: Bools = far - near < EDGE_M + EDGE_SHARE * near
    distance = cv2.distanceTransform(flat.astype(np.uint8), cv2.DIST_L2, 3) * np.float32(hits.step)
    return np.clip(distance / EDGE_PX, 0.05, 1).astype(np.float32)
