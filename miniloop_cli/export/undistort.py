"""Scans as an ideal pinhole camera would have taken them, for tools that know no lens distortion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import Scan


def undistorter(camera: Camera) -> Callable[[Scan], Scan]:
    """A function from a measured scan to the scan of the ideal camera with the same K; the identity if it is ideal.

    Depth takes the nearest pixel, so that none is made up between two surfaces; 0 where nothing was seen.
    """
    if not any(camera.distortion):
        return lambda scan: scan
    import cv2

    size = (camera.width, camera.height)
    maps = cv2.initUndistortRectifyMap(camera.K, np.array(camera.distortion), np.eye(3), camera.K, size, cv2.CV_32FC1)

    def undistort(scan: Scan) -> Scan:
        color = cv2.remap(scan.color, *maps, cv2.INTER_LINEAR)
        depth_m = cv2.remap(scan.depth_m, *maps, cv2.INTER_NEAREST)
        return Scan(np.asarray(color, np.uint8), np.asarray(depth_m, np.float32))

    return undistort
