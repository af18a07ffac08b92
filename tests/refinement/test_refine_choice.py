"""Which refinement a recording gets: bundle adjustment, or beyond a size the pose graph."""

import logging

import numpy as np
import pytest

from miniloop_cli.config import Bundle
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.inputs import Scans
from miniloop_cli.refinement.joint import refine_jointly
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.points import scan_points
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.verdict import Verdict

CAMERA = Camera(500.0, 500.0, 319.5, 239.5, 640, 480)
POINTS = 150


@pytest.mark.parametrize("most", [3, 2])
def test_beyond_a_size_the_pose_graph_is_refined_and_the_log_says_so(most, caplog, rng):
    cloud = rng.uniform((-0.6, -0.5, 1.5), (0.6, 0.5, 2.5), (POINTS, 3))
    T = se3.pose(se3.exp_so3(0.02 * rng.standard_normal((3, 3))), 0.05 * rng.standard_normal((3, 3)))
    features = []
    for T_cam_world in se3.inverse(T):
        p_cam = se3.transform(T_cam_world, cloud)
        px, look = CAMERA.project(p_cam), np.eye(POINTS, 128, dtype=np.float32) * 200
        nothing = np.zeros((POINTS, 2)), np.zeros(POINTS, bool)
        features.append(ScanFeatures(px, px, p_cam[:, 2].copy(), *nothing, look))
    points = [scan_points(found, CAMERA) for found in features]
    rows = np.repeat(np.arange(POINTS)[:, None], 2, axis=1)
    edges = EdgeTable.of(
        [
            Edge(i, j, rows, np.ones(POINTS, bool), se3.inverse(T[j]) @ T[i], 1e6 * np.eye(6), verdict=Verdict.VERIFIED)
            for i, j in ((0, 1), (1, 2), (0, 2))
        ]
    )
    scans = Scans(features, points, np.arange(3.0), np.arange(3.0), CAMERA, "rootsift")
    start = Poses(T @ se3.pose(se3.exp_so3(0.002 * rng.standard_normal((3, 3))), np.zeros((3, 3))), np.zeros(3, int))
    settings = Bundle(max_scans=most, timing=False)
    with caplog.at_level(logging.WARNING, logger="miniloop"):
        found = refine_jointly(start, edges, scans, "bundle", settings, Workers(1))
    off = se3.inverse(found.poses.T_world_cam[0]) @ found.poses.T_world_cam @ se3.inverse(se3.inverse(T[0]) @ T)
    np.testing.assert_allclose(off, np.tile(np.eye(4), (3, 1, 1)), atol=1e-4)
    assert ("bundle.max_scans" in caplog.text) == (most == 2)
