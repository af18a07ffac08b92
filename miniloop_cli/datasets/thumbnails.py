"""Thumbnails of frames: JPEG files in memory, small enough to keep one of every frame."""

from __future__ import annotations

import numpy as np

from miniloop_cli.typing import Bytes

WIDTH_PX = 160
QUALITY = 50


def thumbnail(color: Bytes) -> Bytes:
    """The bytes of a JPEG file of an (h, w, 3) RGB image, WIDTH_PX wide."""
    return small_jpeg(color, WIDTH_PX, QUALITY)


def small_jpeg(color: Bytes, width: int, quality: int) -> Bytes:
    """The bytes of a JPEG file of an (h, w, 3) RGB image, `width` pixels wide; smaller images keep their size."""
    import cv2

    if color.shape[1] > width:
        size = (width, max(1, round(color.shape[0] * width / color.shape[1])))
        color = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    return np.asarray(cv2.imencode(".jpg", np.ascontiguousarray(color[..., ::-1]), options)[1], np.uint8)
