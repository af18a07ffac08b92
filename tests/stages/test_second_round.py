"""The second round finds the pairs that failed where poses are right, and nothing where they are wrong."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from miniloop_cli.config import Settings
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.extracted_scan import ExtractedScan
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.stages.guided_matching import match_again

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
    extracted = [ExtractedScan(found, None, 1.0, 2.0, str(k)) for k, found in enumerate(features)]
    return ScanSet(Sequence("four", Path(), CAMERA, ()), extracted, "rootsift", "four"), T_world_cam


def failed(i, j):
    """An edge of the first round with too few inliers."""
    rows = np.zeros((12, 2), np.int64)
    return Edge(i, j, rows, np.zeros(12, bool), rejection=Rejection.FEW_INLIERS, detail=(2, 12))


def again(edges, T_world_cam, scans, component=(0, 0, 0, 0)):
    poses, settings, table = Poses(T_world_cam, np.array(component)), Settings(), EdgeTable.of(edges)
    found = match_again(poses, table, scans[0], settings.estimation, settings.bundle, 12, Workers(1))
    return {edge.pair: edge for edge in table.replaced(found).edges()}


def test_failed_and_missing_pairs_are_verified_by_right_poses(scans):
    T = scans[1]
    found = again([failed(0, 1)], T, scans)
    assert sorted(found) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    for (i, j), edge in found.items():
        assert (edge.verdict, edge.solver) == (Verdict.VERIFIED, "guided")
        off = se3.inverse(T[j]) @ T[i] @ se3.inverse(edge.T_j_i)
        assert se3.rotation_angle_deg(off[:3, :3]) < 0.2
        assert np.linalg.norm(off[:3, 3]) < 0.01


def test_verified_edges_and_other_components_are_left_alone(scans):
    kept = replace(failed(0, 1), verdict=Verdict.VERIFIED, rejection=Rejection.NONE)
    found = again([kept, failed(0, 3)], scans[1], scans, component=(0, 0, 0, 1))
    assert len(found[0, 1].matches) == 12 and found[0, 1].solver == kept.solver
    assert found[0, 3].verdict == Verdict.REJECTED
    assert sorted(found) == [(0, 1), (0, 2), (0, 3), (1, 2)]


def test_wrong_poses_verify_nothing(scans):
    T = scans[1].copy()
    T[3] = T[3] @ se3.pose(se3.exp_so3(np.array([0.0, 0.0, 0.15])), np.array([0.15, -0.1, 0.2]))
    found = again([failed(0, 3), failed(1, 3)], T, scans)
    assert {pair for pair, edge in found.items() if edge.verdict == Verdict.VERIFIED} == {(0, 1), (0, 2), (1, 2)}
    assert found[0, 3].rejection == Rejection.FEW_INLIERS
