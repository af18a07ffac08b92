"""Pairs of frames with matches verified by colour alone, and how well depth explains them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.config import Depth, Features
from miniloop_cli.errors import InputError
from miniloop_cli.features.detect import comparable
from miniloop_cli.features.keypoints3d import scan_features
from miniloop_cli.features.match import match
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.sequence import Scan
from miniloop_cli.typing import Floats

FEATURES = Features(count=1500)
STEPS = (1, 2, 4, 8, 16, 32)  # from the first to the second frame of a pair
MIN_MATCHES = 30
PNP_PX = 3.0


@dataclass(frozen=True)
class MatchedPair:
    """Matches of frames i < j on one epipolar geometry: (m, 2) undistorted pixels, (m,) depths (m) or NaN."""

    i: int
    j: int
    px_i: Floats
    px_j: Floats
    z_i: Floats
    z_j: Floats

    @property
    def flow_px(self) -> float:
        """Median motion of the matches."""
        return float(np.median(np.linalg.norm(self.px_i - self.px_j, axis=1)))

    def reversed(self) -> MatchedPair:
        """The same pair from j to i."""
        return MatchedPair(self.j, self.i, self.px_j, self.px_i, self.z_j, self.z_i)


class FeatureCache:
    """Features of frames, detected on demand; unreadable frames have none."""

    def __init__(self, read: Callable[[int], Scan], camera: Camera) -> None:
        self.read, self.camera = read, camera
        self.found: dict[int, tuple[ScanFeatures, NDArray] | None] = {}

    def __call__(self, index: int) -> tuple[ScanFeatures, NDArray] | None:
        if index not in self.found:
            try:
                features = scan_features(self.read(index), self.camera, FEATURES, Depth())
                self.found[index] = (features, comparable(features.descriptors, FEATURES.type))
            except InputError:
                self.found[index] = None
        return self.found[index]

    def prefetch(self, indices: Iterable[int]) -> None:
        """Detect features of several frames on all cores."""
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(self, sorted(set(indices))))


def matched_pairs(cache: FeatureCache, count: int, anchors: int) -> list[MatchedPair]:
    """For evenly spaced frames, the two partners farthest ahead that still match well."""
    pairs = []
    firsts = np.unique(np.linspace(0, max(count - 2, 0), anchors).round().astype(int)).tolist()
    cache.prefetch(i + step for i in firsts for step in (0, *STEPS[:3]) if i + step < count)
    for i in firsts:
        found: list[MatchedPair] = []
        for step in STEPS:
            pair = match_frames(cache, i, i + step) if i + step < count else None
            if pair is None:
                break
            found.append(pair)
        pairs += found[-2:]
    return pairs


def match_frames(cache: FeatureCache, i: int, j: int) -> MatchedPair | None:
    """Mutual ratio matches of two frames that agree with one fundamental matrix; None if they are too few."""
    import cv2

    a, b = cache(i), cache(j)
    if a is None or b is None:
        return None
    rows = match(a[1], b[1], 0.8)
    if len(rows) < MIN_MATCHES:
        return None
    p, q = a[0].px_ideal[rows[:, 0]], b[0].px_ideal[rows[:, 1]]
    try:
        mask = cv2.findFundamentalMat(p, q, cv2.USAC_MAGSAC, 1.5, 0.999, 1000)[1]
    except cv2.error:
        return None
    good = np.zeros(len(rows), bool) if mask is None else mask.ravel() > 0
    if good.sum() < MIN_MATCHES:
        return None
    rows = rows[good]
    return MatchedPair(i, j, p[good], q[good], a[0].z_m[rows[:, 0]], b[0].z_m[rows[:, 1]])


def resection(pair: MatchedPair, camera: Camera) -> tuple[Floats, float, int]:
    """Pose of frame j from the depth of i and the pixels of j.

    Returns (4, 4) T_j_i, the share of the matches with depth that it explains (NaN with fewer than 15), their number.
    """
    import cv2

    from miniloop_cli.geometry import se3

    known = np.isfinite(pair.z_i)
    if known.sum() < 15:
        return np.eye(4), float("nan"), int(known.sum())
    points = camera.backproject(pair.px_i[known], pair.z_i[known])
    found, w, t, inliers = cv2.solvePnPRansac(
        points, pair.px_j[known], camera.K, None, iterationsCount=200, reprojectionError=PNP_PX
    )
    if not found or inliers is None:
        return np.eye(4), 0.0, int(known.sum())
    rotation, translation = np.asarray(w, float)[:, 0], np.asarray(t, float)[:, 0]
    return se3.pose(se3.exp_so3(rotation), translation), len(inliers) / int(known.sum()), int(known.sum())
