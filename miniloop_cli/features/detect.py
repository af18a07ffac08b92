"""One factory for every detector: a grey image in, keypoints and descriptors out, strongest first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from miniloop_cli.typing import Bytes, Floats, Floats32, Ints

BINARY = frozenset({"orb", "akaze", "brisk"})
# OpenCV's SIFT doubles the image first and puts every feature so much too far right and down. Its own cure,
# enable_precise_upscale, finds fewer features.
SIFT_SHIFT_PX = 0.25
# Of OpenCV's `size` the share that is the radius of what was found: two sigma of SIFT's Gaussian; the circle of a FAST
# or AGAST corner, where ORB and BRISK state the patch that is described; else half.
RADIUS = {"sift": 1.0, "rootsift": 1.0, "orb": 3.5 / 31, "brisk": 3.5 / 12}


@dataclass(frozen=True)
class Detection:
    """Keypoints of one image, strongest first.

    px: (n, 2) float64 measured pixels; radius_px: (n,) float32 of the blob or corner that was found; response: (n,)
    float32; descriptors: (n, d) as stored: uint8 (bits, or SIFT's histograms) or float32 (SURF). `comparable` makes
    them ready for matching.
    """

    px: Floats
    radius_px: Floats32
    response: Floats32
    descriptors: NDArray[Any]

    def rows(self, which: Ints) -> Detection:
        """The keypoints of these rows, in this order."""
        return Detection(self.px[which], self.radius_px[which], self.response[which], self.descriptors[which])


def detect(gray: Bytes, kind: str, count: int, contrast: float = 0.02) -> Detection:
    """Detect and describe the `count` strongest features of a (h, w) uint8 image.

    `kind`: rootsift (Arandjelović & Zisserman, CVPR 2012), sift, surf, orb, akaze or brisk. Deterministic; ties are
    broken by position.
    """
    if kind == "surf" and not _opencv_has_surf():
        px, radius, response, descriptors = _surf_mahotas(gray, count)
    else:
        keypoints, descriptors = _opencv_detector(kind, count, contrast).detectAndCompute(gray, None)
        px = np.array([k.pt for k in keypoints], float).reshape(-1, 2)
        px -= SIFT_SHIFT_PX if "sift" in kind else 0.0
        radius = np.array([k.size for k in keypoints], np.float32) * np.float32(RADIUS.get(kind, 0.5))
        response = np.array([k.response for k in keypoints], np.float32)
    if descriptors is None or not len(px):
        return _empty(kind)
    order = np.lexsort((px[:, 0], px[:, 1], -response))[:count]
    dtype = np.float32 if kind == "surf" else np.uint8
    return Detection(px[order], radius[order], response[order], np.ascontiguousarray(descriptors[order], dtype))


def comparable(descriptors: NDArray[Any], kind: str) -> NDArray[Any]:
    """Descriptors as `match` wants them: uint8 bits (Hamming) or float32 (Euclidean).

    RootSIFT is SIFT under the Hellinger kernel: square roots of the L1-normalised histogram.
    """
    if kind in BINARY:
        return descriptors
    real = descriptors.astype(np.float32)
    return np.sqrt(real / np.maximum(real.sum(axis=1, keepdims=True), 1)) if kind == "rootsift" else real


def compact(descriptors: NDArray[Any], kind: str) -> tuple[Bytes, float]:
    """Descriptors as small integers (n, d) uint8, and the scale by which their squared distances are divided.

    So scaled, unrelated features are about 1 to 2 apart and the same point seen twice mostly below 0.3, for every kind.
    """
    if kind in BINARY:
        bits = np.unpackbits(descriptors, axis=1)
        return bits, 2 * bits.shape[1] / 3
    if kind == "surf":
        return np.clip(np.rint(127 * descriptors) + 128, 0, 255).astype(np.uint8), 127.0**2
    if kind == "sift":
        return descriptors, 512.0**2  # OpenCV's norm
    return np.rint(255 * comparable(descriptors, "rootsift")).astype(np.uint8), 255.0**2


def _empty(kind: str) -> Detection:
    descriptors = np.zeros((0, 64), np.float32 if kind == "surf" else np.uint8)
    return Detection(np.zeros((0, 2)), np.zeros(0, np.float32), np.zeros(0, np.float32), descriptors)


def _opencv_detector(kind: str, count: int, contrast: float) -> Any:
    # OpenCV 5 moved AKAZE and BRISK from the main module to the contributed one.
    extra = getattr(cv2, "xfeatures2d", cv2)
    if kind in ("sift", "rootsift"):
        return cv2.SIFT_create(nfeatures=count, contrastThreshold=contrast)
    if kind == "orb":
        return cv2.ORB_create(nfeatures=count, fastThreshold=10)
    if kind == "akaze":
        return _where(cv2, extra, "AKAZE_create")(threshold=5e-4)
    if kind == "brisk":
        return _where(cv2, extra, "BRISK_create")(thresh=20)
    if kind == "surf":
        return extra.SURF_create(hessianThreshold=100)
    raise ValueError(f"unknown feature type '{kind}'")


def _where(main: Any, extra: Any, name: str) -> Any:
    return getattr(main, name, None) or getattr(extra, name)


def _opencv_has_surf() -> bool:
    # The symbol is in every build; only builds with the non-free modules can call it.
    try:
        cv2.xfeatures2d.SURF_create()
    except (AttributeError, cv2.error):
        return False
    return True


def _surf_mahotas(gray: Bytes, count: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    from mahotas.features import surf

    # Columns: y, x, scale, score, laplacian, angle, then 64 descriptor values.
    found = surf.surf(gray, nr_octaves=4, nr_scales=6, initial_step_size=1, threshold=0.1, max_points=count)
    px, descriptors = found[:, [1, 0]].astype(float), found[:, 6:].astype(np.float32)
    return px, 2 * found[:, 2].astype(np.float32), found[:, 3].astype(np.float32), descriptors
