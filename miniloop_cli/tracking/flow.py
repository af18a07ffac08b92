"""Points tracked from one image to another by optical flow, checked forwards and backwards."""

from __future__ import annotations

from typing import Any

import numpy as np

from miniloop_cli.typing import Bools, Bytes, Floats32

WINDOW_PX = 15
LEVELS, MORE_LEVELS = 2, 4  # of the pyramid: with a good guess, and without one
MAX_RETURN_PX = 0.5  # a point that returns farther from its start is discarded
BORDER_PX = 5  # the window would leave the image
CORNER_QUALITY, CORNER_DISTANCE_PX, CORNER_BLOCK_PX = 0.005, 9, 3
LEAST_CORNER = (3.5 / 255) ** 2  # mean squared gradient, full scale a pixel; noise has less


def follow(before: Bytes, after: Bytes, px: Floats32, guess_px: Floats32, sure: bool) -> tuple[Floats32, Bools]:
    """Positions (n, 2) in the image `after` of the points px (n, 2) of `before`, both (h, w); which were found (n,).

    guess_px (n, 2): start of the search; `sure`: it is right within some pixels. Pyramidal Lucas-Kanade (Bouguet
    2001), forwards and backwards.
    """
    if not len(px):
        return px, np.zeros(0, bool)
    levels = LEVELS if sure else MORE_LEVELS
    found, there = _lucas_kanade(before, after, px, guess_px, levels)
    returned, back = _lucas_kanade(after, before, found, px, levels)
    height, width = after.shape
    inside = (found >= BORDER_PX).all(axis=1) & (found < (width - BORDER_PX, height - BORDER_PX)).all(axis=1)
    return found, there & back & inside & (np.abs(returned - px).max(axis=1) < MAX_RETURN_PX)


def _lucas_kanade(a: Bytes, b: Bytes, px: Floats32, guess_px: Floats32, levels: int) -> tuple[Floats32, Bools]:
    import cv2

    stop: Any = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
    size = (WINDOW_PX, WINDOW_PX)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        a, b, px[:, None], guess_px[:, None].copy(), None, None, size, levels, stop, cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    return np.asarray(found, np.float32)[:, 0], status.ravel() > 0


def new_corners(gray: Bytes, known_px: Floats32, count: int, allowed: Bools) -> Floats32:
    """At most `count` corners (m, 2) of an image (h, w), the strongest first, away from the known points.

    allowed (h, w): where corners may lie. Shi & Tomasi (1994).
    """
    import cv2

    if count <= 0:
        return np.zeros((0, 2), np.float32)
    free = allowed.astype(np.uint8)
    for x, y in np.rint(known_px).astype(int).tolist():
        cv2.circle(free, (x, y), CORNER_DISTANCE_PX, (0,), -1)
    found = cv2.goodFeaturesToTrack(gray, count, CORNER_QUALITY, CORNER_DISTANCE_PX, mask=free)
    if found is None:
        return np.zeros((0, 2), np.float32)
    px = np.asarray(found, np.float32).reshape(-1, 2)
    x, y = px.astype(int).T
    return px[cv2.cornerMinEigenVal(gray, CORNER_BLOCK_PX)[y, x] > LEAST_CORNER]
