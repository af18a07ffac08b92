"""Numbers of single frames: depth range, holes, blur, exposure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.scene.sequence import Scan


@dataclass(frozen=True)
class FrameNumbers:
    """Numbers of one frame. `sharpness` only compares frames of one recording."""

    holes: float  # share of pixels without reading
    depth_m: tuple[float, float, float]  # 5 %, 50 %, 95 % of the readings; 0 without any
    sharpness: float  # standard deviation of the Laplacian over that of the image
    brightness: float  # mean grey level, 0 to 255
    saturated: float  # share of pixels at the upper end
    dark: float  # share of pixels below 16


def frame_numbers(scan: Scan) -> FrameNumbers:
    """The numbers of a scan."""
    import cv2

    gray = cv2.cvtColor(scan.color, cv2.COLOR_RGB2GRAY)
    readings = scan.depth_m[scan.depth_m > 0]
    quantiles = np.quantile(readings, [0.05, 0.5, 0.95]) if len(readings) else np.zeros(3)
    return FrameNumbers(
        holes=1 - len(readings) / scan.depth_m.size,
        depth_m=(float(quantiles[0]), float(quantiles[1]), float(quantiles[2])),
        sharpness=float(cv2.Laplacian(gray, cv2.CV_32F).std() / max(float(gray.std()), 1.0)),
        brightness=float(gray.mean()),
        saturated=float((gray >= 252).mean()),
        dark=float((gray < 16).mean()),
    )
