"""Features of a grey image, and their descriptors in the form for matching, by the name of their type."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.feature_types import FEATURE_TYPES, Detector, Keypoints
from miniloop_cli.typing import Bytes, Floats, Floats32, Ints


@dataclass(frozen=True)
class Detection:
    """Keypoints of one image, strongest first.

    px: (n, 2) float64 measured pixels; radius_px: (n,) float32 of the blob or corner that was found; response: (n,)
    float32; descriptors: (n, d) as stored. `comparable` converts them for matching.
    """

    px: Floats
    radius_px: Floats32
    response: Floats32
    descriptors: NDArray[Any]

    def rows(self, which: Ints) -> Detection:
        """The keypoints of the rows `which` (k,), in this order."""
        return Detection(self.px[which], self.radius_px[which], self.response[which], self.descriptors[which])


def detect(gray: Bytes, kind: str, count: int, contrast: float = 0.02, first_octave: int = -1) -> Detection:
    """Detect and describe the `count` strongest features of a (h, w) uint8 image; `kind` is one of FEATURE_TYPES.

    first_octave: of SIFT, -1 or 0 (Lowe 2004, section 3.3). Deterministic; ties are broken by position.
    """
    feature_type = FEATURE_TYPES[kind]
    detector = feature_type.detector
    if first_octave == 0 and feature_type.blob:
        detector = partial(_from_own_size, detector)
    found = detector(gray, count, contrast)
    order = np.lexsort((found.px[:, 0], found.px[:, 1], -found.response))[:count]
    descriptors = np.ascontiguousarray(found.descriptors[order], feature_type.descriptors.dtype)
    return Detection(found.px[order], found.radius_px[order], found.response[order], descriptors)


def _from_own_size(doubling: Detector, gray: Bytes, count: int, contrast: float) -> Keypoints:
    """Keypoints from the image at its own size: a detector that doubles its image gets an image of half the size."""
    import cv2

    half = np.asarray(cv2.resize(gray, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
    found = doubling(half, count, contrast)
    # A pixel of the half image is the mean of four, so its centre lies between theirs.
    return found._replace(px=2 * found.px + 0.5, radius_px=2 * found.radius_px)


def comparable(descriptors: NDArray[Any], kind: str) -> NDArray[Any]:
    """Stored descriptors (n, d) of a type in the form for `match`: uint8 bits (Hamming) or float32 (Euclidean)."""
    return FEATURE_TYPES[kind].descriptors.comparable(descriptors)


def compact(descriptors: NDArray[Any], kind: str) -> tuple[Bytes, float]:
    """Stored descriptors of a type as small integers (n, d) uint8, and the scale of their squared distances.

    Divided by that, unrelated features are about 1 to 2 apart and the same point seen twice mostly below 0.3.
    """
    return FEATURE_TYPES[kind].descriptors.compact(descriptors)
