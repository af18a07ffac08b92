"""Points of a map are the means of what saw them, weighted by how certain each observation is."""

import numpy as np
from map_scenes import some_pose

from miniloop_cli.geometry import se3
from miniloop_cli.mapping.landmarks import MAX_CHI2, POSE_SIGMA_M, landmarks
from miniloop_cli.refinement.tracks import Tracks
from miniloop_cli.scene.points import ScanPoints

SCANS, POINTS = 5, 40


def seen(rng):
    """Poses, scans of all points with noise of their covariances, and the points."""
    T = np.array([some_pose(rng) for _ in range(SCANS)])
    points = rng.normal(size=(POINTS, 3))
    scans = []
    for pose in T:
        half = 0.01 * rng.normal(size=(POINTS, 3, 3))
        C = half @ half.transpose(0, 2, 1) + 1e-6 * np.eye(3)
        noise = np.einsum("kij,kj->ki", np.linalg.cholesky(C), rng.normal(size=(POINTS, 3)))
        scans.append(ScanPoints(se3.transform(se3.inverse(pose), points) + noise, C))
    return T, scans, points


def all_tracks():
    point, frame = np.divmod(np.arange(SCANS * POINTS), SCANS)
    return Tracks(frame, point, point.copy(), POINTS, 0)


def test_points_are_weighted_means_without_what_contradicts_them(rng):
    T, scans, points = seen(rng)
    scans[2].covariances_m2[7] = 0.02**2 * np.eye(3)  # else the others would contradict the mean, too
    scans[2].points_m[7] += 0.5
    found = landmarks(scans, T, all_tracks())
    number = found.of_feature.reshape(SCANS, POINTS)
    assert number[2, 7] == -1
    for k in range(POINTS):
        total, weighted, kept = np.zeros((3, 3)), np.zeros(3), number[:, k] >= 0
        for scan, pose, mine in zip(scans, T, kept, strict=True):
            R = pose[:3, :3]
            weight = np.linalg.inv(R @ scan.covariances_m2[k] @ R.T + POSE_SIGMA_M**2 * np.eye(3))
            total, weighted = total + mine * weight, weighted + mine * weight @ (R @ scan.points_m[k] + pose[:3, 3])
        mean, C = np.linalg.solve(total, weighted), np.linalg.inv(total)
        (at,) = np.unique(number[kept, k])
        np.testing.assert_allclose(found.points_m[at], mean, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found.covariances_m2[at], C + POSE_SIGMA_M**2 * np.eye(3), rtol=1e-9)
        off = found.points_m[at] - points[k]
        assert off @ np.linalg.solve(found.covariances_m2[at], off) < 2 * MAX_CHI2


def test_what_is_seen_once_is_no_point(rng):
    T, scans, _ = seen(rng)
    found = landmarks(scans, T, Tracks(np.array([0, 1, 3]), np.array([0, 0, 1]), np.array([4, 4, 9]), 2, 0))
    assert len(found.points_m) == 1
    assert (found.of_feature >= 0).sum() == 2
    assert found.of_feature[3 * POINTS + 9] == -1
