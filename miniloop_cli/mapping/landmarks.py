"""Points of a map: fused observations of several keyframes, with covariances."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.refinement.tracks import Tracks
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.scene_map import MapPoints
from miniloop_cli.typing import Bools, Floats, Ints

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
    p_cam = np.concatenate([scan.points_m for scan in points])[row]
    C_cam = np.concatenate([scan.covariances_m2 for scan in points])[row]
    p_world, information = np.empty((len(row), 3)), np.empty((len(row), 3, 3))
    _in_world(p_cam, C_cam, np.ascontiguousarray(T_world_cam), tracks.frame, p_world, information)
    mean, covariance = np.empty((tracks.count, 3)), np.empty((tracks.count, 3, 3))
    agreeing = np.ones(len(row), bool)
    for _ in range(2):
        _fuse(p_world, information, tracks.track, agreeing, mean, covariance)
    seen = np.bincount(tracks.track[agreeing], minlength=tracks.count)
    good = np.flatnonzero(seen >= 2)
    number = np.full(tracks.count, -1)
    number[good] = np.arange(len(good))
    of_feature[row[agreeing]] = number[tracks.track[agreeing]]
    return MapPoints(mean[good], covariance[good] + POSE_SIGMA_M**2 * np.eye(3), of_feature)


@njit(cache=True, nogil=True, error_model="numpy")
def _in_world(
    p_cam: Floats, C_cam: Floats, T_world_cam: Floats, frame: Ints, p_world: Floats, information: Floats
) -> None:
    """Fill p_world (k, 3) and information (k, 3, 3) of points p_cam (k, 3), C_cam (k, 3, 3) in frames (k,).

    T_world_cam (n, 4, 4). The error of the poses is the same in all directions, so it is added in the camera's frame.
    """
    C, own, turned = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(frame)):
        T = T_world_cam[frame[k]]
        for i in range(3):
            for j in range(3):
                C[i, j] = C_cam[k, i, j]
            C[i, i] += POSE_SIGMA_M * POSE_SIGMA_M
            p_world[k, i] = T[i, 0] * p_cam[k, 0] + T[i, 1] * p_cam[k, 1] + T[i, 2] * p_cam[k, 2] + T[i, 3]
        _invert(C, own)
        for i in range(3):
            for j in range(3):
                turned[i, j] = T[i, 0] * own[0, j] + T[i, 1] * own[1, j] + T[i, 2] * own[2, j]
        for i in range(3):
            for j in range(3):
                information[k, i, j] = turned[i, 0] * T[j, 0] + turned[i, 1] * T[j, 1] + turned[i, 2] * T[j, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def _fuse(p: Floats, information: Floats, track: Ints, agreeing: Bools, mean: Floats, covariance: Floats) -> None:
    """Fill mean (t, 3) and covariance (t, 3, 3) of the tracks, and tell anew which observations (k,) agree with them.

    p (k, 3), information (k, 3, 3), track (k,): those that agree before take part. A track without any has its mean at
    0.
    """
    total, weighted = np.empty((3, 3)), np.empty(3)
    for t in range(len(mean)):
        for i in range(3):
            mean[t, i] = 0.0
            for j in range(3):
                covariance[t, i, j] = 0.0
    for k in range(len(track)):
        t = track[k]
        if not agreeing[k]:
            continue
        for i in range(3):
            for j in range(3):
                covariance[t, i, j] += information[k, i, j]
                mean[t, i] += information[k, i, j] * p[k, j]
    for t in range(len(mean)):
        for i in range(3):
            weighted[i] = mean[t, i]
            for j in range(3):
                total[i, j] = covariance[t, i, j]
            if total[i, i] == 0.0:
                total[i, i] = 1.0
        _invert(total, covariance[t])
        for i in range(3):
            mean[t, i] = (
                covariance[t, i, 0] * weighted[0]
                + covariance[t, i, 1] * weighted[1]
                + covariance[t, i, 2] * weighted[2]
            )
    for k in range(len(track)):
        chi2 = 0.0
        for i in range(3):
            for j in range(3):
                chi2 += (p[k, i] - mean[track[k], i]) * information[k, i, j] * (p[k, j] - mean[track[k], j])
        agreeing[k] = chi2 < MAX_CHI2


@njit(cache=True, nogil=True, error_model="numpy")
def _invert(A: Floats, inverse: Floats) -> None:
    """Fill the inverse (3, 3) of a matrix A (3, 3)."""
    for i in range(3):
        for j in range(3):
            a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            inverse[i, j] = A[c, a] * A[d, b] - A[c, b] * A[d, a]
    determinant = A[0, 0] * inverse[0, 0] + A[0, 1] * inverse[1, 0] + A[0, 2] * inverse[2, 0]
    for i in range(3):
        for j in range(3):
            inverse[i, j] /= determinant
