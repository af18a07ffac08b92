"""Edges that close hardly any of the loops of three they lie on."""

import numpy as np
import pytest

from benchmarks.experiments.view_graphs import view_graph
from miniloop_cli.config import Averaging
from miniloop_cli.geometry.pose_rows import rows
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.verification.consensus import average_verified
from miniloop_cli.verification.triangles import doubtful

NEAR = (float(np.cos(np.radians(5) / 2)), 0.1**2)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.5])
def test_false_edges_are_doubted(share):
    graph = view_graph("video", 60, 700, share, 0.5, 0.01, np.random.default_rng(5))
    out = doubtful(60, graph.pairs, rows(graph.T_j_i), NEAR)
    assert out[graph.false].mean() > 0.9 if share else not out.any()
    assert out[~graph.false].mean() < share / 2 + 1e-9  # a doubt is no verdict: see below


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
@pytest.mark.parametrize("seed", range(3))
def test_true_edges_come_back(share, seed):
    graph = view_graph("video", 40, 300, share, 0.3, 0.005, np.random.default_rng(seed))
    inliers = np.ones(50, bool)
    edges = [
        Edge(int(i), int(j), np.zeros((50, 2), int), inliers, T, 1e4 * np.eye(6), verdict=Verdict.VERIFIED)
        for (i, j), T in zip(graph.pairs, graph.T_j_i, strict=True)
    ]
    table = EdgeTable.of(edges)
    order = np.lexsort(graph.pairs.T[::-1])
    false = graph.false[order]
    poses, judged = average_verified(table, 40, Averaging())
    rejected = ~judged.open
    assert (poses.component == 0).all()
    assert rejected[false].all() and not rejected[~false].any()
    assert (judged.rejection[rejected] == Rejection.CONTRADICTS_POSES).all()


def test_nothing_goes_out_where_nothing_is_sure():
    tree = np.array([(0, 1), (1, 2), (2, 3)])
    graph = view_graph("expander", 4, 6, 0.0, 0.0, 0.0, np.random.default_rng(0))
    identity = np.tile(np.eye(4), (3, 1, 1))
    assert not doubtful(4, tree, rows(identity), NEAR).any()
    random = view_graph("expander", 12, 40, 0.99, 0.0, 0.0, np.random.default_rng(0))
    assert not doubtful(12, random.pairs, rows(random.T_j_i), NEAR).any()
    assert not doubtful(4, graph.pairs, rows(graph.T_j_i), NEAR).any()


def test_a_scan_that_hangs_on_one_edge_keeps_it():
    """Scans 0 to 4 see each other; scan 5 hangs on a true edge and a false one that contradict: neither is sure."""
    rng = np.random.default_rng(1)
    graph = view_graph("expander", 6, 15, 0.0, 0.0, 0.0, rng)
    keep = (graph.pairs.max(axis=1) < 5) | np.isin(graph.pairs, (0, 1)).any(axis=1)
    pairs, T = graph.pairs[keep], graph.T_j_i[keep].copy()
    wrong = (pairs == [1, 5]).all(axis=1) | (pairs == [5, 1]).all(axis=1)
    T[wrong] = view_graph("expander", 2, 1, 0.0, 0.0, 0.0, np.random.default_rng(9)).T_j_i
    assert wrong.sum() == 1 and not doubtful(6, pairs, rows(T), NEAR).any()


def test_the_direction_of_an_edge_does_not_matter():
    graph = view_graph("video", 30, 200, 0.2, 0.5, 0.01, np.random.default_rng(2))
    T = np.linalg.inv(graph.T_j_i)
    there = doubtful(30, graph.pairs, rows(graph.T_j_i), NEAR)
    back = doubtful(30, np.ascontiguousarray(graph.pairs[:, ::-1]), rows(T), NEAR)
    assert there.any() and (there != back).mean() < 0.02  # a residual at the very limit may be judged from either end
