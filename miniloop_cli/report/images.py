"""Images of frames, the two images of an edge with their matches, and image files in memory."""

from __future__ import annotations

import base64

import cv2
import numpy as np

from miniloop_cli.datasets import read_color
from miniloop_cli.errors import InputError
from miniloop_cli.report.spacing import evenly_spaced
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.typing import Bytes, Floats

MAX_LINES = 120  # more lines hide the images


def jpeg(rgb: Bytes, quality: int = 82) -> Bytes:
    """The bytes of a JPEG file of an (h, w, 3) RGB image."""
    return cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]


def png(rgb: Bytes) -> Bytes:
    """The bytes of a PNG file of an (h, w, 3) RGB image."""
    return cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))[1]


def data_uri(file: Bytes, kind: str = "jpeg") -> str:
    """The bytes (n,) of an image file of this kind (jpeg or png) as a data URI."""
    return f"data:image/{kind};base64,{base64.b64encode(file.tobytes()).decode('ascii')}"


def frame_image(sequence: Sequence, index: int, width: int) -> tuple[Bytes, float] | None:
    """Colour (h, width, 3) of a frame and its scale; None if it cannot be read."""
    try:
        color = read_color(sequence.frames[index].color)
    except (InputError, IndexError):
        return None
    scale = width / color.shape[1]
    size = (width, max(1, round(color.shape[0] * scale)))
    return np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8), scale


def match_picture(sequence: Sequence, i: int, j: int, px_i: Floats, px_j: Floats, width: int = 400) -> Bytes | None:
    """Both images side by side, inliers px_i, px_j (k, 2), measured pixels, joined; None if one is unreadable."""
    left, right = frame_image(sequence, i, width), frame_image(sequence, j, width)
    if left is None or right is None:
        return None
    height = max(left[0].shape[0], right[0].shape[0])
    picture = np.zeros((height, 2 * width, 3), np.uint8)
    picture[: left[0].shape[0], :width], picture[: right[0].shape[0], width:] = left[0], right[0]
    keep = evenly_spaced(len(px_i), MAX_LINES)
    hues = np.linspace(0, 150, max(len(keep), 1)).astype(np.uint8)
    paint = cv2.cvtColor(np.stack([hues, np.full_like(hues, 230), np.full_like(hues, 255)], 1)[None], cv2.COLOR_HSV2RGB)
    # The colour depends on the height in the left image, so that lines that cross others are visible.
    for rank, k in enumerate(sorted(keep, key=lambda k: px_i[k, 1])):
        a = px_i[k] * left[1]
        b = px_j[k] * right[1] + [width, 0]
        if not (np.isfinite(a).all() and np.isfinite(b).all() and max(np.abs(a).max(), np.abs(b).max()) < 1e4):
            continue
        ends = [tuple(round(v) for v in p) for p in (a, b)]
        color = tuple(int(v) for v in paint[0, rank])
        cv2.line(picture, ends[0], ends[1], color, 1, cv2.LINE_AA)
        for end in ends:
            cv2.circle(picture, end, 3, color, 1, cv2.LINE_AA)
    return picture
