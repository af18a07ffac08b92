"""Points tracked from one image to another by optical flow, checked forwards and backwards."""

from __future__ import annotations

from typing import Any

import numpy as np

from miniloop_cli.typing import Bools, Bytes, Floats32

WINDOW_PX = 15
LEVELS, MORE_LEVELS = 2, 4  # of the pyramid: with a good guess, and without one
MAX_RETURN_PX = 0.5  # a point that returns farther from its start is discarded
BORDER_PX = 5  # the window would leave the image
MAX_DIFFERENCE = 0.75  # of two windows on average, in contrasts of the first; that of windows of noise is 0.8 and more
LEAST_CORRELATION = 0.35  # of windows that differ by more, by blur or exposure; of noise, 99 of 100 have less than 0.3
CORNER_QUALITY, CORNER_DISTANCE_PX, CORNER_BLOCK_PX = 0.005, 9, 3
LEAST_CORNER = (3.5 / 255) ** 2  # mean squared gradient, full scale a pixel; noise has less


def follow(
    before: Bytes, after: Bytes, px: Floats32, contrast: Floats32, guess_px: Floats32, sure: bool
) -> tuple[Floats32, Bools]:
    """Positions (n, 2) in the image `after` of the points px (n, 2) of `before`, both (h, w); which were found (n,).

    contrast (n,): of the points in `before`, as `contrasts` gives it. guess_px (n, 2): start of the search; `sure`: it
    is right within some pixels. Pyramidal Lucas-Kanade (Bouguet 2001), forwards and backwards. In the dark, noise has
    corners, and a third of them return to their start; so the windows must be alike as well.
    """
    if not len(px):
        return px, np.zeros(0, bool)
    levels = LEVELS if sure else MORE_LEVELS
    found, there, difference = _lucas_kanade(before, after, px, guess_px, levels)
    returned, back, _ = _lucas_kanade(after, before, found, px, levels)
    height, width = after.shape
    inside = (found >= BORDER_PX).all(axis=1) & (found < (width - BORDER_PX, height - BORDER_PX)).all(axis=1)
    good = there & back & inside & (np.abs(returned - px).max(axis=1) < MAX_RETURN_PX)
    other = np.flatnonzero(good & ~(difference < MAX_DIFFERENCE * contrast))
    if len(other):
        good[other] = _correlation(before, after, px[other], found[other]) > LEAST_CORRELATION
    return found, good


def _lucas_kanade(
    a: Bytes, b: Bytes, px: Floats32, guess_px: Floats32, levels: int
) -> tuple[Floats32, Bools, Floats32]:
    """Positions (n, 2), which were found (n,), and the mean difference (n,) of both windows in grey levels."""
    import cv2

    stop: Any = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
    size = (WINDOW_PX, WINDOW_PX)
    found, status, difference = cv2.calcOpticalFlowPyrLK(
        a, b, px[:, None], guess_px[:, None].copy(), None, None, size, levels, stop, cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    return np.asarray(found, np.float32)[:, 0], status.ravel() > 0, np.asarray(difference, np.float32).ravel()


def _correlation(before: Bytes, after: Bytes, px: Floats32, found: Floats32) -> Floats32:
    """(n,) correlation of the windows at px (n, 2) and at `found` (n, 2)."""
    import cv2

    y, x = np.mgrid[:WINDOW_PX, :WINDOW_PX].reshape(2, -1).astype(np.float32) - WINDOW_PX // 2
    windows = []
    for image, at in ((before, px), (after, found)):
        window = np.asarray(cv2.remap(image, at[:, :1] + x, at[:, 1:] + y, cv2.INTER_LINEAR), np.float32)
        window -= window.mean(axis=1, keepdims=True)
        windows.append(window / np.maximum(np.linalg.norm(window, axis=1, keepdims=True), 1e-6))
    return np.asarray((windows[0] * windows[1]).sum(axis=1), np.float32)


def contrasts(gray: Bytes, px: Floats32) -> Floats32:
    """(n,) standard deviation of the grey levels in the window of each point px (n, 2) of an image (h, w)."""
    import cv2

    size = (WINDOW_PX, WINDOW_PX)
    mean, square = cv2.boxFilter(gray, cv2.CV_32F, size), cv2.sqrBoxFilter(gray, cv2.CV_32F, size)
    x, y = px.astype(int).T
    return np.sqrt(np.maximum(np.asarray(square)[y, x] - np.asarray(mean)[y, x] ** 2, 0.0))


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
