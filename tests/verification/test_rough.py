"""Rough poses: which pairs they name, which edges they exclude, and poses given in other conventions."""

from dataclasses import replace

import numpy as np
import pytest

from miniloop_cli.config import PosePrior
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.conventions import OPENGL_AXES
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.verification.pose_prior import pairs_by_pose_prior, reject_by_pose_prior

CAMERA = Camera(525.0, 525.0, 319.5, 239.5, 640, 480, 5000.0)
SCANS = 24


@pytest.fixture
def turn(rng):
    """Scans that turn once around on the spot in a room of points about 2 m away, and their exact edges."""
    yaw = 2 * np.pi * np.arange(SCANS) / SCANS
    wave = 0.5 * np.sin(yaw)[:, None] * [0.2, 1.0, 0.3]
    T = se3.pose(se3.exp_so3(yaw[:, None] * [0, 1, 0]) @ se3.exp_so3(wave * [1, 0, 0]), wave)
    z = rng.uniform(1.5, 2.5, 200)
    px = rng.uniform(0, 1, (200, 2)) * [640, 480]
    points = [ScanPoints(CAMERA.backproject(px, z), np.zeros((200, 3, 3)))] * SCANS
    edges = []
    for i in range(SCANS):
        for j in range(i + 1, min(i + 4, SCANS)):
            T_j_i = se3.inverse(T[j]) @ T[i]
            edges.append(Edge(i, j, np.zeros((30, 2), int), np.ones(30, bool), T_j_i, verdict=Verdict.VERIFIED))
    return T, points, edges


def test_pairs_that_may_overlap(turn):
    T, points, _ = turn
    pairs = pairs_by_pose_prior(T, points, CAMERA, PosePrior(max_deg=5, max_m=0.1))
    steps = {min(j - i, SCANS - j + i) for i, j in pairs}
    assert steps == set(range(1, max(steps) + 1))  # the turn closes: the last sees what the first saw
    assert 4 <= max(steps) <= 6  # 15 degrees a step, 63 degrees of view
    wide = pairs_by_pose_prior(T, points, CAMERA, PosePrior(max_deg=25, max_m=0.1))
    assert set(pairs) < set(wide)
    assert len(wide) < SCANS * (SCANS - 1) / 2


def test_a_frame_without_a_pose_is_compared_with_all(turn):
    T, points, _ = turn
    T = T.copy()
    T[5] = np.nan
    pairs = pairs_by_pose_prior(T, points, CAMERA, PosePrior())
    assert sum(5 in pair for pair in pairs) == SCANS - 1


def test_edges_are_judged(turn):
    T, _, edges = turn
    shift = se3.pose(np.eye(3), np.array([0.8, 0, 0]))
    edges[0] = replace(edges[0], T_j_i=shift @ edges[0].T_j_i)
    edges[1] = replace(edges[1], inliers=np.arange(30) < 7)
    judged = reject_by_pose_prior(EdgeTable.of(edges), T, PosePrior())
    assert judged.verified.tolist() == [False] + [True] * (len(edges) - 1)
    assert judged.rejection[0] == Rejection.CONTRADICTS_POSE_PRIOR
    assert judged.reasons()[0] == "contradicts the pose prior by 0 deg, 0.80 m"
    assert judged.confirmed[:3].tolist() == [False, False, True]


def test_another_world_is_as_good(turn, rng):
    T, _, edges = turn
    moved = se3.pose(se3.exp_so3(np.array([1.0, 2.0, 0.5])), np.array([10.0, -5, 3])) @ T
    assert reject_by_pose_prior(EdgeTable.of(edges), moved, PosePrior()).verified.all()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda T: T @ OPENGL_AXES, r"read as camera axes x right, y up, z backward"),
        (se3.inverse, "read as poses world to camera"),
        (
            lambda T: se3.pose(T[:, :3, :3], 1000 * T[:, :3, 3]),
            "read as poses camera to world, in millimetres",
        ),
        (lambda T: se3.pose(T[:, :3, :3], 10 * T[:, :3, 3] + 3 * np.arange(SCANS)[:, None]), "give metres"),
    ],
    ids=["opengl", "inverse", "millimetres", "scale"],
)
def test_other_conventions_are_recognised(turn, given, said):
    T, _, edges = turn
    with pytest.raises(InputError, match=said):
        reject_by_pose_prior(EdgeTable.of(edges), given(T), PosePrior(max_deg=5, max_m=0.2))
