"""The image file of a texture."""

from __future__ import annotations

import cv2
import numpy as np

from miniloop_cli.typing import Bytes

QUALITY = 92  # of JPEG


def jpeg(rgb: Bytes) -> Bytes:
    """The bytes of a JPEG file of (h, w, 3) RGB."""
    bgr = np.ascontiguousarray(rgb[..., ::-1])
    return np.asarray(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1], np.uint8)
