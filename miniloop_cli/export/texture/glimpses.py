"""Data kept of every fused scan: its sharpness, and its depth as a small image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from miniloop_cli.scene.sequence import Scan
from miniloop_cli.typing import Bytes

SHARPNESS_WIDTH = 640  # images are compared at this width, as more pixels only add noise
SMALL_WIDTH = 96
BLUR_PX = 9


@dataclass(frozen=True)
class Glimpse:
    """`sharpness` in [0, 1]; `depth_m` (h, w) float16, every N-th pixel of the depth, 0 = no reading."""

    sharpness: float
    depth_m: NDArray[np.float16]


class Glimpses(dict[int, Glimpse]):
    """Glimpses by row of the trajectory; an observer of the fusion."""

    def __call__(self, row: int, scan: Scan) -> None:
        """Keep the glimpse of a scan."""
        step = max(1, round(scan.depth_m.shape[1] / SMALL_WIDTH))
        small = scan.depth_m[step // 2 :: step, step // 2 :: step]
        self[row] = Glimpse(sharpness(scan.color), np.minimum(small, 6e4).astype(np.float16))


def sharpness(color: Bytes) -> float:
    """The share of the differences between neighbouring pixels that a blur removes, in [0, 1], in the worse direction.

    An image that is already blurred, by motion or by focus, changes little (Crete et al. 2007, The blur effect). The
    amount of texture cancels out.
    """
    grey = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2GRAY)
    if grey.shape[1] > SHARPNESS_WIDTH:
        height = round(grey.shape[0] * SHARPNESS_WIDTH / grey.shape[1])
        grey = cv2.resize(grey, (SHARPNESS_WIDTH, height), interpolation=cv2.INTER_AREA)
    lost = []
    for axis in (0, 1):
        blurred = cv2.blur(grey, (BLUR_PX, 1) if axis else (1, BLUR_PX))
        before, after = (np.abs(np.diff(image.astype(np.int16), axis=axis)) for image in (grey, blurred))
        lost.append(float(np.maximum(before - after, 0).sum() / max(int(before.sum()), 1)))
    return min(lost)
