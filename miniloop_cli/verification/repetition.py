"""Scans that repeat themselves: tiles, wallpaper, rows of equal windows.

If a scan shows a repeated pattern, its matches identify the pattern in another scan, but not which part of it. Such a
scan fits itself under a motion: most of its features have doubles in the same image, and many doubles are related by
one rigid motion, a period of the pattern.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.config import Ransac
from miniloop_cli.features.detect import compact
from miniloop_cli.geometry import se3
from miniloop_cli.ransac.estimate import estimate
from miniloop_cli.ransac.matches import edge_matches
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.scan_set import ScanSet

COUNT = 500  # strongest features that are compared
APART = 0.04  # of the width of the image: nearer doubles may be one feature detected twice
DOUBLE = 0.12  # squared descriptor distance (see `compact`) of doubles: nearer than most true matches
MIN_DOUBLES = 0.33  # share of the features that have one; MIN_FIT then distinguishes patterns from chance
MIN_FIT, MIN_INLIERS = 0.06, 12  # of the doubles under one motion, as a share of the features and in number


def pattern_steps_m(scans: ScanSet, ransac: Ransac, chi2: float, workers: Workers) -> list[float]:
    """`pattern_step_m` of every scan."""

    def one(scan: int) -> float:
        features, points = scans.features[scan], scans.points[scan]
        return pattern_step_m(features, points, scans.camera.width, scans.feature_type, ransac, chi2)

    return list(workers.map(one, range(len(scans)), "looking for repetition", len(scans)))


def pattern_step_m(
    features: ScanFeatures, points: ScanPoints, width_px: int, feature_type: str, ransac: Ransac, chi2: float
) -> float:
    """Shortest distance (m) by which the scan can move and fit itself; 0 if it does not repeat."""
    count = min(features.with_depth, COUNT)
    if count < MIN_INLIERS:
        return 0.0
    descriptors, scale = compact(features.descriptors[:count], feature_type)
    real = descriptors.astype(np.float32)
    norm2 = np.einsum("ij,ij->i", real, real)
    distance2 = (norm2[:, None] + norm2 - 2 * real @ real.T) / np.float32(scale)
    x, y = features.px_ideal[:count].T.astype(np.float32)
    near = (np.abs(x[:, None] - x) < APART * width_px) & (np.abs(y[:, None] - y) < APART * width_px)
    distance2[near] = np.inf
    double = distance2.argmin(axis=1)
    rows = np.flatnonzero(distance2[np.arange(count), double] < DOUBLE)
    if len(rows) < max(MIN_DOUBLES * count, MIN_INLIERS):
        return 0.0
    matches = edge_matches([points, points], (0, 1), np.stack([rows, double[rows]], axis=1))
    found = estimate([matches], ransac, chi2, np.random.default_rng(0))
    if found is None:
        return 0.0
    fit = found.edges[0]
    if fit.inliers.sum() < max(MIN_FIT * count, MIN_INLIERS):
        return 0.0
    moved = se3.transform(fit.T, matches.p[fit.inliers]) - matches.p[fit.inliers]
    return float(np.median(np.linalg.norm(moved, axis=1)))
