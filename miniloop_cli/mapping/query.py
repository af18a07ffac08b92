"""An image prepared to be located in a map."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from miniloop_cli.config import Depth, Features
from miniloop_cli.features.keypoints3d import scan_features
from miniloop_cli.features.thumbnail import make_view
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.sequence import Scan
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Bytes, Floats32

NO_TIMING = Timing()
MAX_WIDTH_PX = 1280  # larger photographs are reduced, as keyframes have no finer detail
UNKNOWN_M = np.float32(1e6)  # the depth of cells without depth, compatible with any distance


@dataclass(frozen=True)
class Query:
    """An image to locate: features (z_m is NaN without depth), view, camera.

    `rough`: the focal length is a guess, and estimated with the pose. `timing`: of the camera, if known;
    `with_depth`: depth was measured.
    """

    features: ScanFeatures
    view: View | None
    camera: Camera
    rough: bool = False
    timing: Timing = NO_TIMING
    with_depth: bool = False


def query_of(
    color: Bytes,
    depth_m: Floats32 | None,
    camera: Camera,
    features: Features,
    depth: Depth,
    rough: bool = False,
    timing: Timing = NO_TIMING,
) -> Query:
    """The query of an image (h, w, 3) uint8, with depth (h, w) in metres, if there is any.

    `rough`: the focal length is a guess; `timing`: of the camera, if known.
    """
    factor = min(1.0, MAX_WIDTH_PX / max(color.shape[:2]))
    if factor < 1:
        color, depth_m, camera = _smaller(color, depth_m, camera, factor)
    scan = Scan(color, np.zeros(color.shape[:2], np.float32) if depth_m is None else depth_m)
    view = make_view(scan, camera, depth)
    if depth_m is None:
        # Without readings, nothing is hidden, and any distance fits.
        seen = view.gray > 0
        view = replace(view, high_m=np.where(seen, UNKNOWN_M, np.float32(0)))
    return Query(scan_features(scan, camera, features, depth), view, camera, rough, timing, depth_m is not None)


def _smaller(
    color: Bytes, depth_m: Floats32 | None, camera: Camera, factor: float
) -> tuple[Bytes, Floats32 | None, Camera]:
    import cv2

    width, height = round(factor * color.shape[1]), round(factor * color.shape[0])
    x, y = width / color.shape[1], height / color.shape[0]
    color = np.asarray(cv2.resize(color, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    if depth_m is not None:
        depth_m = np.asarray(cv2.resize(depth_m, (width, height), interpolation=cv2.INTER_NEAREST_EXACT), np.float32)
    # Pixel centres are at integers: the corner of the image is at -1/2.
    middle = (camera.cx + 0.5) * x - 0.5, (camera.cy + 0.5) * y - 0.5
    return (
        color,
        depth_m,
        replace(camera, fx=camera.fx * x, fy=camera.fy * y, cx=middle[0], cy=middle[1], width=width, height=height),
    )
