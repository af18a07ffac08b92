"""Loops over verified edges: what they predict, when they vouch for a weak edge, and that they add no false one."""

import numpy as np
import pytest

from miniloop_cli.config import Settings, Verification
from miniloop_cli.geometry import se3
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.stages.solve_edges import promote_by_loops, solve_cycles
from miniloop_cli.verification.loop_support import AGREE_DEG, AGREE_M, Prediction, agree, pose_graph, predict


def random_poses(rng, count):
    return se3.pose(se3.exp_so3(rng.normal(size=(count, 3), scale=0.3)), rng.normal(size=(count, 3), scale=0.3))


def relative(T_world_cam, i, j):
    return se3.inverse(T_world_cam[j]) @ T_world_cam[i]


def graph_of(T_world_cam, pairs, wrong=()):
    shift = se3.pose(np.eye(3), np.array([0.5, 0.0, 0.0]))
    edges = [(i, j, relative(T_world_cam, i, j), 50 + i) for i, j in pairs]
    return pose_graph((i, j, shift @ T if (i, j) in wrong else T, n) for i, j, T, n in edges)


def test_loops_predict_the_pose(rng):
    T = random_poses(rng, 6)
    pairs = [(0, k) for k in (2, 3, 4)] + [(1, k) for k in (2, 3, 4)]
    found = predict(graph_of(T, pairs), (0, 1))
    np.testing.assert_allclose(found.T_j_i, relative(T, 0, 1), atol=1e-12)
    assert found.cycle[0] == 0 and found.cycle[2] == 1 and (found.others, found.agree, found.credible) == (2, 2, True)
    found = predict(graph_of(T, pairs, wrong=[(1, 3)]), (0, 1))
    np.testing.assert_allclose(found.T_j_i, relative(T, 0, 1), atol=1e-12)
    assert (found.others, found.agree, found.credible) == (2, 1, True)


def test_loops_that_contradict_each_other_or_stand_alone_are_no_evidence(rng):
    T = random_poses(rng, 5)
    assert predict(graph_of(T, [(0, 2)]), (0, 1)) is None
    assert predict(graph_of(T, [(0, 2), (1, 3)]), (0, 1)) is None
    assert not predict(graph_of(T, [(0, 2), (1, 2)]), (0, 1)).credible
    two = [(0, 2), (1, 2), (0, 3), (1, 3)]
    assert predict(graph_of(T, two), (0, 1)).credible
    assert not predict(graph_of(T, two, wrong=[(0, 2)]), (0, 1)).credible


def test_agreement_has_limits():
    for size, alike in ((0.9, True), (1.1, False)):
        turn = se3.pose(se3.exp_so3(np.array([0, 0, np.radians(size * AGREE_DEG)])), np.zeros(3))
        shift = se3.pose(np.eye(3), np.array([size * AGREE_M, 0, 0]))
        assert agree(np.eye(4), turn) == agree(np.eye(4), shift) == alike


@pytest.mark.parametrize(
    ("inliers", "verdict", "agreeing", "off_m", "expected"),
    [
        (7, Verdict.WEAK, 2, 0.0, Verdict.VERIFIED),
        (7, Verdict.WEAK, 0, 0.0, Verdict.WEAK),  # nothing else says so
        (7, Verdict.WEAK, 2, 0.2, Verdict.WEAK),  # loops say something else
        (5, Verdict.REJECTED, 2, 0.0, Verdict.REJECTED),
    ],
)
def test_only_weak_edges_that_agree_are_vouched_for(inliers, verdict, agreeing, off_m, expected):
    edge = Edge(0, 1, np.zeros((20, 2), int), np.arange(20) < inliers, verdict=verdict, rejection=Rejection.FEW_INLIERS)
    loops = Prediction((0, 2, 1), se3.pose(np.eye(3), np.array([off_m, 0, 0])), 2, agreeing)
    found = promote_by_loops(edge, loops, Verification())
    assert found.verdict == expected
    assert (found.loops, found.rejection) == (
        (3, Rejection.NONE) if expected == Verdict.VERIFIED else (0, Rejection.FEW_INLIERS)
    )


def few_matches(rng, true, chance):
    """Five scans of one cloud, all pairs well matched but (0, 1): `true` right matches and `chance` wrong ones."""
    T = random_poses(rng, 5)
    cloud = rng.uniform(-2, 2, (400, 3)) + np.array([0, 0, 3.0])
    sigma = 0.005
    points = [
        ScanPoints(
            se3.transform(se3.inverse(pose), cloud) + rng.normal(size=cloud.shape, scale=sigma),
            np.broadcast_to(sigma**2 * np.eye(3), (400, 3, 3)),
        )
        for pose in T
    ]
    matches = {}
    for i in range(5):
        for j in range(i + 1, 5):
            rows = rng.permutation(400)[:60] if (i, j) != (0, 1) else rng.permutation(400)[: true + chance]
            other = rows.copy()
            if (i, j) == (0, 1):
                other[true:] = rng.permutation(400)[:chance]
            matches[i, j] = np.stack([rows, other], axis=1)
    return T, points, matches


@pytest.mark.parametrize("seed", range(5))
def test_seven_true_matches_are_enough_where_loops_agree(seed):
    T, points, matches = few_matches(np.random.default_rng(seed), 7, 13)

    def edge(*overrides):
        edges = solve_cycles(matches, points, load_settings(overrides=overrides).estimation, 0, Workers(1))
        assert edges.edge(0).pair == (0, 1)
        return edges.edge(0), edges.reasons()[0]

    assert edge("cycles.loop_support=false")[0].verdict != Verdict.VERIFIED
    found, reason = edge()
    assert found.verdict == Verdict.VERIFIED and reason == "7 inliers of 20 matches; 3 loops over verified edges agree"
    E = se3.inverse(found.T_j_i) @ relative(T, 0, 1)
    assert se3.rotation_angle_deg(E[:3, :3]) < 0.5 and np.linalg.norm(E[:3, 3]) < 0.01
    assert found.inliers[:7].all() and found.solver == "cycle3"


@pytest.mark.parametrize("seed", range(5))
def test_chance_matches_are_never_vouched_for(seed):
    _, points, matches = few_matches(np.random.default_rng(seed), 0, 25)
    edges = solve_cycles(matches, points, Settings().estimation, 0, Workers(1))
    assert edges.verified.tolist() == [False] + [True] * 9


def test_the_number_of_jobs_changes_nothing():
    _, points, matches = few_matches(np.random.default_rng(9), 7, 13)
    one, two = (solve_cycles(matches, points, Settings().estimation, 0, Workers(jobs)) for jobs in (1, 2))
    for name, column in one.arrays().items():
        assert column.tobytes() == two.arrays()[name].tobytes(), name
