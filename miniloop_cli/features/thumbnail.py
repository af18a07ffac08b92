"""The view of a scan: a small image with depth, to compare scans that overlap."""

from __future__ import annotations

from functools import cache

import numpy as np

from miniloop_cli.config import Depth
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import Scan
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.typing import Ints

COLUMNS = 64  # cells across the image; 10 pixels each at a width of 640, coarser than the effects of timing
EDGE = 0.06  # spread of depth in a cell, as a share, beyond which it is not one surface


def make_view(scan: Scan, camera: Camera, depth: Depth) -> View:
    """The view of a scan; depth outside of the range of `depth` is ignored."""
    import cv2

    pixel, start, cell, shape = _cells(camera, scan.depth_m.shape)
    gray, near, far = np.zeros((3, shape[0] * shape[1]), np.float32)
    if len(cell):
        brightness = cv2.cvtColor(scan.color, cv2.COLOR_RGB2GRAY).ravel()[pixel].astype(np.float32)
        gray[cell] = np.add.reduceat(brightness, start) / np.diff([*start, len(pixel)])
        z = scan.depth_m.ravel()[pixel]
        z = np.where((z >= depth.min_m) & (z <= depth.max_m), z, np.float32(0))  # NaN compares false
        far[cell] = np.maximum.reduceat(z, start)
        near[cell] = np.minimum.reduceat(np.where(z > 0, z, np.float32(np.inf)), start)
    near[far == 0] = 0
    one_surface = far - near <= EDGE * near
    gray, near, far = (array.reshape(shape) for array in (gray, near, far))
    square = np.ones((3, 3), np.uint8)
    low = np.asarray(cv2.erode(np.where(near > 0, near, np.float32(1e9)), square), np.float32)
    high = np.asarray(cv2.dilate(far, square), np.float32)
    z_m = np.where(one_surface.reshape(shape), 0.5 * (near + far), 0).astype(np.float32)
    return View(gray, z_m, np.where(high > 0, low, 0), high)


@cache
def _cells(camera: Camera, shape: tuple[int, int]) -> tuple[Ints, Ints, Ints, tuple[int, int]]:
    """Pixels of an image grouped by cell: numbers in order, start and cell of each group; rows, columns."""
    height, width = shape
    size_px = width / COLUMNS
    rows = int(np.ceil(height / size_px))
    stride = max(width // 320, 1)
    v, u = (grid.ravel() for grid in np.mgrid[0:height:stride, 0:width:stride])
    column, row = np.floor((camera.undistort(np.stack([u, v], 1)) + 0.5) / size_px).astype(np.int64).T
    inside = (column >= 0) & (column < COLUMNS) & (row >= 0) & (row < rows)
    cell, pixel = (row * COLUMNS + column)[inside], (v * width + u)[inside]
    order = np.argsort(cell, kind="stable")
    cells, start = np.unique(cell[order], return_index=True)
    return pixel[order], start, cells, (rows, COLUMNS)
