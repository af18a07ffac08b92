"""The second round finds the pairs that failed where poses are right, and nothing where they are wrong."""

from dataclasses import replace

import numpy as np
import pytest

from miniloop_cli.config import Settings
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import REJECTED, VERIFIED, Edge
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.points import scan_points
from miniloop_cli.scene.poses import Poses
from miniloop_cli.stages.guided_matching import match_guided, replace_edges

CAMERA = Camera(525, 525, 319.5, 239.5, 640, 480)


@pytest.fixture(scope="module")
def scans():
    """Features of four scans of a cloud of points, half of which look like many others; and the true poses."""
    rng = np.random.default_rng(0)
    cloud = rng.uniform((-0.9, -0.7, 1.5), (0.9, 0.7, 3.0), (400, 3))
    look = rng.integers(0, 120, (400, 128)).astype(np.float32)
    motion = np.concatenate([0.03 * rng.standard_normal((4, 3)), 0.05 * rng.standard_normal((4, 3))], axis=1)
    T_world_cam = se3.pose(se3.exp_so3(motion[:, :3]), motion[:, 3:])
    features = []
    for T_cam_world in se3.inverse(T_world_cam):
        p_cam = se3.transform(T_cam_world, cloud)
        px = CAMERA.project(p_cam) + 0.4 * rng.standard_normal((400, 2))
        order = rng.permutation(400)
        noise = rng.integers(0, 3, (400, 128)).astype(np.float32)
        features.append(
            ScanFeatures(
                px[order],
                px[order],
                p_cam[order, 2].copy(),
                np.zeros((400, 2)),
                np.zeros(400, bool),
                (look + noise)[order],
            )
        )
    return features, [scan_points(found, CAMERA) for found in features], T_world_cam


def failed(i, j):
    """An edge of the first round with too few inliers."""
    reason = "2 inliers of 12 matches"
    return Edge(i, j, np.zeros((12, 2), np.int64), np.zeros(12, bool), verdict=REJECTED, reason=reason)


def again(edges, T_world_cam, scans, component=(0, 0, 0, 0)):
    features, points, _ = scans
    poses = Poses(T_world_cam, np.array(component))
    found = match_guided(edges, poses, features, points, CAMERA, Settings(), Workers(1))
    return {(e.i, e.j): e for e in replace_edges(edges, found)}


def test_failed_and_missing_pairs_are_verified_by_right_poses(scans):
    T = scans[2]
    found = again([failed(0, 1)], T, scans)
    assert sorted(found) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    for (i, j), edge in found.items():
        assert (edge.verdict, edge.solver) == (VERIFIED, "guided")
        off = se3.inverse(T[j]) @ T[i] @ se3.inverse(edge.T_j_i)
        assert se3.rotation_angle_deg(off[:3, :3]) < 0.2
        assert np.linalg.norm(off[:3, 3]) < 0.01


def test_verified_edges_and_other_components_are_left_alone(scans):
    kept = replace(failed(0, 1), verdict=VERIFIED, reason="")
    found = again([kept, failed(0, 3)], scans[2], scans, component=(0, 0, 0, 1))
    assert found[0, 1] is kept
    assert found[0, 3].verdict == REJECTED
    assert sorted(found) == [(0, 1), (0, 2), (0, 3), (1, 2)]


def test_wrong_poses_verify_nothing(scans):
    T = scans[2].copy()
    T[3] = T[3] @ se3.pose(se3.exp_so3(np.array([0.0, 0.0, 0.15])), np.array([0.15, -0.1, 0.2]))
    found = again([failed(0, 3), failed(1, 3)], T, scans)
    assert {pair for pair, edge in found.items() if edge.verdict == VERIFIED} == {(0, 1), (0, 2), (1, 2)}
    assert found[0, 3].reason == "2 inliers of 12 matches"
