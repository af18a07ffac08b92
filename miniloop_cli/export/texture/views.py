"""The choice of scans for the texture: few, sharp and near ones that together see the whole surface."""

from __future__ import annotations

import numpy as np

from miniloop_cli.export.mesh_model import Mesh, vertex_normals
from miniloop_cli.export.texture.glimpses import Glimpse, Glimpses
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.typing import Floats, Floats32, Ints

MOST_SAMPLES = 8000  # of the surface
MOST_CANDIDATES = 1500
MOST_VIEWS = 400
LEAST_GAIN = 5e-4  # of the quality of a perfect choice: views that add less only cause seams
LEAST_COSINE = 0.1  # between a ray and the surface's normal: below, an image is not used
NEAR_M = 0.1
HIDDEN_M, HIDDEN_SHARE = 0.05, 0.92  # an object hides a point if it is nearer by more
BORDER_PX = 3
SHARPNESS_POWER = 4  # a blurred image must be much nearer than a sharp one to be preferred


def choose_views(mesh: Mesh, glimpses: Glimpses, T_world_cam: Floats, camera: Camera) -> Ints:
    """Ascending rows (k,) of the trajectory T_world_cam (n, 4, 4) whose scans show the surface best.

    Greedy: the next view adds most to the sum, over the surface, of the quality of the best chosen view relative to the
    best of all (facility location; Nemhauser et al. 1978).
    """
    rows = sharpest(glimpses)
    points, normals = samples(mesh)
    quality = np.stack([quality_at(points, normals, T_world_cam[row], camera, glimpses[row]) for row in rows])
    quality /= np.maximum(quality.max(axis=0), np.float32(1e-12))
    best, bound = np.zeros(len(points), np.float32), quality.sum(axis=1)
    chosen: list[int] = []
    while len(chosen) < MOST_VIEWS:
        k = int(bound.argmax())
        gain = float(np.maximum(quality[k] - best, 0).sum())
        bound[k] = gain
        if gain < bound.max():  # the bound of another view is outdated: compute it again
            continue
        if gain < LEAST_GAIN * len(points):
            break
        chosen.append(rows[k])
        best, bound[k] = np.maximum(best, quality[k]), 0.0
    return np.array(sorted(chosen), np.int64)


def sharpest(glimpses: Glimpses) -> list[int]:
    """All rows; in a long recording the sharpest of every few neighbours."""
    rows = sorted(glimpses)
    groups = np.array_split(rows, min(len(rows), MOST_CANDIDATES))
    return [max(group.tolist(), key=lambda row: glimpses[row].sharpness) for group in groups]


def samples(mesh: Mesh) -> tuple[Floats32, Floats32]:
    """Points (k, 3) and normals (k, 3) spread evenly over the surface: means over the cells of a grid."""
    normals = vertex_normals(mesh)
    cell_m = 0.04
    while True:
        cells = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / cell_m).astype(np.int64)
        _, number, count = np.unique(cells @ [1, 1 << 20, 1 << 40], return_inverse=True, return_counts=True)
        if len(count) <= MOST_SAMPLES:
            break
        cell_m *= 1.3

    def means(values: Floats32) -> Floats32:
        sums = [np.bincount(number, values[:, axis]) / count for axis in range(3)]
        return np.stack(sums, axis=1).astype(np.float32)

    directions = means(normals)
    return means(mesh.vertices), directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-6)


def quality_at(points: Floats32, normals: Floats32, T_world_cam: Floats, camera: Camera, glimpse: Glimpse) -> Floats32:
    """(k,) quality of each point in a scan: pixels an area and sharpness; 0 if it is hidden.

    points (k, 3) m and normals (k, 3) in the world, T_world_cam (4, 4).
    """
    quality = np.zeros(len(points), np.float32)
    rows, px, z, cosine = looked_at(points, normals, T_world_cam, camera)
    h, w = glimpse.depth_m.shape
    u, v = ((px + 0.5) * [w / camera.width, h / camera.height]).astype(np.int64).T
    seen_m = glimpse.depth_m[v, u].astype(np.float32)
    open_ = (seen_m == 0) | (seen_m > HIDDEN_SHARE * z - HIDDEN_M)
    quality[rows] = open_ * density(z, cosine, camera) * sharpness_weight(glimpse)
    return quality


def looked_at(
    points: Floats32, normals: Floats32, T_world_cam: Floats, camera: Camera
) -> tuple[Ints, Floats32, Floats32, Floats32]:
    """Points in front of a camera, within its image and turned to it: their rows, pixels, depths (m) and cosines.

    points (k, 3) m and normals (k, 3) in the world, T_world_cam (4, 4). Of the n points that are: (n,) rows, (n, 2)
    pixels, (n,) depths along the optical axis, and (n,) cosines between ray and normal.
    """
    T = se3.inverse(T_world_cam).astype(np.float32)
    x, y, z = T[:3, :3] @ points.T + T[:3, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = (
            np.float32(camera.fx) * x / z + np.float32(camera.cx),
            np.float32(camera.fy) * y / z + np.float32(camera.cy),
        )
    right, bottom = camera.width - 1 - BORDER_PX, camera.height - 1 - BORDER_PX
    rows = np.flatnonzero((z > NEAR_M) & (u > BORDER_PX) & (v > BORDER_PX) & (u < right) & (v < bottom))
    x, y, z, u, v = (column[rows] for column in (x, y, z, u, v))
    n = T[:3, :3] @ normals[rows].T
    cosine = -(n[0] * x + n[1] * y + n[2] * z) / np.sqrt(x * x + y * y + z * z)
    facing = np.flatnonzero(cosine > LEAST_COSINE)
    px = np.stack([u[facing], v[facing]], axis=1)
    return rows[facing], px, z[facing], cosine[facing]


def density(z_m: Floats32, cosine: Floats32, camera: Camera) -> Floats32:
    """Pixels a square metre of surface at depths (n,) and cosines (n,) of the angles to the rays."""
    return np.float32(camera.fx * camera.fy) / z_m**2 * cosine


def sharpness_weight(glimpse: Glimpse) -> np.float32:
    """The weight of a pixel of a scan."""
    return np.float32(glimpse.sharpness**SHARPNESS_POWER)
