"""Scans as of an ideal pinhole camera, for tools without this lens model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.sequence import Scan, Sequence
from miniloop_cli.typing import Bools

OUTSIDE_PX = -1e4  # for pixels that the lens does not image


def undistorter(camera: Camera) -> Callable[[Scan], Scan]:
    """A function from a measured scan to the scan of the ideal camera with the same K; the identity if it is ideal.

    Depth is that of the nearest pixel, never interpolated between two surfaces; 0 where nothing was seen.
    """
    if camera.lens.ideal:
        return lambda scan: scan
    import cv2

    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    measured = camera.distort(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(camera.height, camera.width, 2)
    measured = np.nan_to_num(measured, nan=OUTSIDE_PX).clip(OUTSIDE_PX, -OUTSIDE_PX).astype(np.float32)
    maps = np.ascontiguousarray(measured[..., 0]), np.ascontiguousarray(measured[..., 1])

    def undistort(scan: Scan) -> Scan:
        color = cv2.remap(scan.color, *maps, cv2.INTER_LINEAR)
        depth_m = cv2.remap(scan.depth_m, *maps, cv2.INTER_NEAREST)
        mask = None
        if scan.mask is not None:
            mask = cv2.remap(scan.mask.astype(np.uint8), *maps, cv2.INTER_NEAREST) > 0
        return Scan(np.asarray(color, np.uint8), np.asarray(depth_m, np.float32), mask)

    return undistort


def imaged(camera: Camera) -> Bools:
    """(h, w) whether the lens images each pixel of undistorted images; barrel distortion leaves a black border."""
    white = np.full((camera.height, camera.width, 3), 255, np.uint8)
    seen: Bools = undistorter(camera)(Scan(white, np.zeros(white.shape[:2], np.float32))).color[..., 0] == 255
    return seen


def write_color(path: Path, scan: Scan) -> Path:
    """Write the colour of a scan as a PNG file."""
    return write_png(path, scan.color[..., ::-1])


def stored_scale(sequence: Sequence) -> float:
    """Units a metre of the depth images: millimetres if the recording's are floating-point."""
    return 1000.0 if sequence.depth_format.floating else sequence.camera.depth_scale


def write_depth(path: Path, scan: Scan, depth_scale: float) -> Path:
    """Write the depth of a scan as a 16-bit PNG file, in units a metre; 0 where there is none, or it is too far."""
    stored = np.rint(scan.depth_m * depth_scale)
    return write_png(path, np.where(stored < 1 << 16, stored, 0).astype(np.uint16))


def write_png(path: Path, image: NDArray[Any]) -> Path:
    """Write (h, w) or (h, w, 3) BGR pixels as a PNG file."""
    import cv2

    _, data = cv2.imencode(".png", np.ascontiguousarray(image))
    with atomic_write(path, "wb") as file:
        file.write(data.tobytes())
    return path
