"""Points of a map: fused observations of several keyframes, with covariances."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.refinement.tracks import Tracks
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.scene_map import MapPoints
from miniloop_cli.typing import Floats, Ints

MAX_CHI2 = 16.0  # of an observation against the others of its point
POSE_SIGMA_M = 0.002  # error of a point by the poses, which does not decrease with the number of observations


def landmarks(points: Sequence[ScanPoints], T_world_cam: Floats, tracks: Tracks) -> MapPoints:
    """Points seen by two or more keyframes.

    points: the features of each keyframe in space; T_world_cam (n, 4, 4). A point is the mean of its observations,
    weighted by the inverse covariances. An observation with more than MAX_CHI2 is left out.
    """
    offsets = np.cumsum([0, *(len(scan.points_m) for scan in points)])
    of_feature = np.full(int(offsets[-1]), -1)
    if not tracks.count:
        return MapPoints(np.zeros((0, 3)), np.zeros((0, 3, 3)), of_feature)
    row = offsets[tracks.frame] + tracks.feature
    T = T_world_cam[tracks.frame]
    p_cam = np.concatenate([scan.points_m for scan in points])[row]
    C_cam = np.concatenate([scan.covariances_m2 for scan in points])[row]
    p_world = np.einsum("kij,kj->ki", T[:, :3, :3], p_cam) + T[:, :3, 3]
    C_world = T[:, :3, :3] @ C_cam @ np.swapaxes(T[:, :3, :3], 1, 2) + POSE_SIGMA_M**2 * np.eye(3)
    information = np.linalg.inv(C_world)
    agreeing = np.ones(len(row), bool)
    for _ in range(2):
        mean, covariance = fused(p_world, information, np.where(agreeing, tracks.track, tracks.count), tracks.count)
        off = p_world - mean[tracks.track]
        agreeing = np.einsum("ki,kij,kj->k", off, information, off) < MAX_CHI2
    seen = np.bincount(tracks.track[agreeing], minlength=tracks.count)
    good = np.flatnonzero(seen >= 2)
    number = np.full(tracks.count, -1)
    number[good] = np.arange(len(good))
    of_feature[row[agreeing]] = number[tracks.track[agreeing]]
    return MapPoints(mean[good], covariance[good] + POSE_SIGMA_M**2 * np.eye(3), of_feature)


def fused(points: Floats, information: Floats, group: Ints, count: int) -> tuple[Floats, Floats]:
    """Means (count, 3) and covariances (count, 3, 3) of points (k, 3) with information (k, 3, 3), group by group.

    group (k,): numbers below `count`; others are left out. A group without points has its mean at 0.
    """
    weighted = np.einsum("kij,kj->ki", information, points)
    columns = np.concatenate([information.reshape(-1, 9), weighted], axis=1).T
    sums = np.stack([np.bincount(group, column, count)[:count] for column in columns], axis=1)
    total, weighted = sums[:, :9].reshape(-1, 3, 3), sums[:, 9:]
    total[~total.any(axis=(1, 2))] = np.eye(3)
    covariance = np.asarray(np.linalg.inv(total), float)
    return np.einsum("kij,kj->ki", covariance, weighted), covariance
