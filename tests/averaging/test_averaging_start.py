"""The voted start and its parts."""

import networkx as nx
import numpy as np
import pytest

from benchmarks.experiments.view_graphs import view_graph
from miniloop_cli.averaging import voting
from miniloop_cli.averaging.initialization import tree_start, voted_start
from miniloop_cli.geometry.pose_rows import compose, invert, load
from miniloop_cli.geometry.se3 import inverse, pose
from miniloop_cli.scene.view_graph import adjacency


def rows_of(T):
    from scipy.spatial.transform import Rotation

    return np.hstack([Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True), T[:, :3, 3]])


def poses_of(rows):
    from scipy.spatial.transform import Rotation

    return pose(Rotation.from_quat(rows[:, :4], scalar_first=True).as_matrix(), rows[:, 4:])


NEAR = (float(np.cos(np.radians(3.0))), 0.1**2)


def test_rows_compose_and_invert_as_matrices_do():
    rng = np.random.default_rng(0)
    T = view_graph("expander", 20, 30, 0.0, 0.0, 0.0, rng).T_world_cam
    rows = rows_of(T)
    a, b = load(rows, 3), load(rows, 4)
    np.testing.assert_allclose(poses_of(np.array([compose(a, b)]))[0], T[3] @ T[4], atol=1e-12)
    np.testing.assert_allclose(poses_of(np.array([invert(a)]))[0], inverse(T[3]), atol=1e-12)


@pytest.mark.parametrize(("kind", "outliers"), [("video", 0.0), ("video", 0.2), ("expander", 0.2)])
def test_poses_are_found_among_outliers(kind, outliers):
    graph = view_graph(kind, 300, 2400, outliers, 0.3, 0.01, np.random.default_rng(1))
    T = poses_of(voted_start(300, graph.pairs, rows_of(graph.T_j_i), np.ones(2400), NEAR))
    i, j = graph.pairs[~graph.false].T
    true = inverse(graph.T_world_cam[j]) @ graph.T_world_cam[i]
    mine = inverse(T[j]) @ T[i]
    assert np.mean(np.linalg.norm(mine[:, :3, 3] - true[:, :3, 3], axis=1) < 0.2) > 0.99


def test_a_segment_held_by_one_false_edge_is_put_right_by_its_many_true_ones():
    """Two chains of scans joined by three true edges and one false: the chains agree within, only clusters can move."""
    rng = np.random.default_rng(2)
    T = view_graph("expander", 40, 60, 0.0, 0.0, 0.0, rng).T_world_cam
    near = [(a, b) for half in (0, 20) for a in range(half, half + 20) for b in range(a + 1, min(a + 4, half + 20))]
    pairs = np.array([*near, (5, 30), (2, 22), (10, 28), (15, 36)])
    T_j_i = inverse(T[pairs[:, 1]]) @ T[pairs[:, 0]]
    T_j_i[len(near)] = T[7]
    start = poses_of(voted_start(40, pairs, rows_of(T_j_i), np.ones(len(pairs)), NEAR))
    np.testing.assert_allclose(inverse(start[:1]) @ start, inverse(T[:1]) @ T, atol=1e-6)


def test_triangles_tell_true_edges_from_false_ones():
    graph = view_graph("video", 200, 1600, 0.2, 0.3, 0.01, np.random.default_rng(3))
    rows = adjacency(200, graph.pairs)
    votes = np.empty(1600)
    voting.loop_votes(0, 1600, graph.pairs, rows_of(graph.T_j_i), np.ones(1600), *rows, NEAR, votes)
    assert np.median(votes[~graph.false]) > 0.7
    assert np.median(votes[graph.false]) < 0.5


def test_tree_is_the_maximum_spanning_tree():
    rng = np.random.default_rng(4)
    graph = view_graph("expander", 30, 100, 0.0, 5.0, 0.0, rng)
    weights = rng.permutation(100) + 1.0
    q = tree_start(30, graph.pairs, rows_of(graph.T_j_i)[:, :4], weights)
    R = poses_of(np.hstack([q, np.zeros((30, 3))]))[:, :3, :3]
    followed = {
        (int(i), int(j))
        for (i, j), R_j_i in zip(graph.pairs, graph.T_j_i[:, :3, :3], strict=True)
        if np.allclose(R[j].T @ R[i], R_j_i, atol=1e-9)
    }
    oracle = nx.Graph()
    oracle.add_weighted_edges_from((i, j, w) for (i, j), w in zip(graph.pairs.tolist(), weights, strict=True))
    assert followed == {tuple(sorted(edge)) for edge in nx.maximum_spanning_edges(oracle, data=False)}


def test_of_parallel_edges_the_tree_takes_the_heaviest():
    q_j_i = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0]])
    q = tree_start(2, np.array([(0, 1), (1, 0), (0, 1)]), q_j_i, np.array([1.0, 3.0, 2.0]))
    np.testing.assert_allclose(np.abs(q[1 - int(np.argmax(np.abs(q[:, 0])))]), [0, 1, 0, 0], atol=1e-12)
