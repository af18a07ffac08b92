"""`python -m benchmarks outliers`: false edges are what they are said to be, and what is measured is what is said."""

import csv
import importlib.util
import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks
from benchmarks.experiments.false_edges import FALSE_DEG, FALSE_M, KEPT_EDGES, true_graph, with_false_edges
from benchmarks.experiments.outliers import METHODS, graph_rows, miniloop
from miniloop_cli.api import simulate
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.registration import RegistrationError
from miniloop_cli.scene.verdict import Verdict

# The graph that they begin with is a recording registered.
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("own_cache")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return simulate(tmp_path_factory.mktemp("outliers") / "loop", frames=16, width=320, height=240)


@pytest.fixture(scope="module")
def graph(folder):
    return true_graph(folder, 16, 0, Workers(2))


def is_off(edges, graph):
    E = se3.inverse(graph.motions(edges.i, edges.j)) @ edges.T_j_i
    return (se3.rotation_angle_deg(E[:, :3, :3]) > FALSE_DEG) | (np.linalg.norm(E[:, :3, 3], axis=1) > FALSE_M)


@pytest.mark.parametrize("kind", ["random", "consistent"])
@pytest.mark.parametrize("share", [0.1, 0.3])
def test_false_edges_are_false_and_as_many_as_asked_for(graph, kind, share):
    edges, false = with_false_edges(graph, kind, share, np.random.default_rng(3))
    np.testing.assert_array_equal(edges.pairs, np.unique(edges.pairs, axis=0))
    assert false.mean() == pytest.approx(share, abs=0.02)
    np.testing.assert_array_equal(is_off(edges, graph), false)
    degree = np.bincount(edges.pairs[~false].ravel())
    was = np.bincount(graph.edges.pairs.ravel())
    assert (degree >= np.minimum(was, KEPT_EDGES)).all()
    true = [pair in edges.pairs[~false].tolist() for pair in graph.edges.pairs.tolist()]
    np.testing.assert_array_equal(edges.subset(~false).T_j_i, graph.edges.subset(true).T_j_i)
    again, _ = with_false_edges(graph, kind, share, np.random.default_rng(3))
    np.testing.assert_array_equal(edges.T_j_i, again.T_j_i)


def test_consistent_edges_agree_in_where_the_other_scans_lie(graph):
    """Of one cluster, T_b T_b_a inv(T_a) is the same for all its edges, but for noise."""
    T = graph.T_world_cam

    def from_first_deg(kind):
        edges, false = with_false_edges(graph, kind, 0.1, np.random.default_rng(3))
        edges = edges.subset(false)
        moved = T[edges.j] @ edges.T_j_i @ se3.inverse(T[edges.i])
        return se3.rotation_angle_deg((se3.inverse(moved[0]) @ moved)[1:, :3, :3])

    consistent = from_first_deg("consistent")
    assert len(consistent) > 4 and np.median(consistent) < 1
    assert np.median(from_first_deg("random")) > 5


def test_command_on_a_recording(folder, tmp_path):
    arguments = ["outliers", str(folder), "--no-simulated", "--percent", "20", "--runs", "2", "-o", str(tmp_path)]
    result = CliRunner().invoke(benchmarks, [*arguments, "--json", "-", "-q"])
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)["rows"]
    assert [(r["kind"], r["method"]) for r in rows] == [(k, m) for k in ("random", "consistent") for m in METHODS]
    for row in rows:
        assert 0.15 < row["false_share"] < 0.25 and row["clean_ate_cm"] < 1
        if row["method"] == "miniloop":  # what the scans show tells of single edges and of whole clusters
            assert row["within_share"] == row["rot_within_share"] == 1
            assert row["false_kept_mean"] == 0 and row["true_lost_mean"] < 0.05
    with (tmp_path / "outliers.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(rows)
    assert (tmp_path / "outliers.png").read_bytes().startswith(b"\x89PNG")


def test_a_result_that_is_wrong_is_not_within(graph):
    def believes_all(graph, edges):
        T, posed, _ = miniloop(graph, graph.edges)
        wrong = np.random.default_rng(0).normal(size=(len(T), 3)) if len(edges) != len(graph.edges) else 0
        T[:, :3, 3] += wrong
        return T, posed, replace(edges, verdict=np.full(len(edges), Verdict.VERIFIED))

    rows = list(graph_rows(graph, [0.2], 2, methods={"wrong": believes_all}))
    assert [row["within_share"] for row in rows] == [0, 0] and [row["rot_within_share"] for row in rows] == [1, 1]
    assert [row["false_kept_mean"] for row in rows] == [1, 1]


@pytest.mark.skipif(not importlib.util.find_spec("gtsam"), reason="gtsam is not installed (extra bench)")
def test_peers_solve_the_clean_graph(graph):
    from benchmarks.experiments.peers.outliers import installed

    for name, solve in installed().items():
        T, posed, _ = solve(graph, graph.edges)
        assert posed[graph.scans].all(), name
        R = graph.T_world_cam[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
        assert se3.rotation_angle_deg(np.swapaxes(R[:1], 1, 2) @ R).max() < 1, name


def test_too_few_scans_is_said(tmp_path):
    few = simulate(tmp_path / "few", frames=3, width=160, height=120, path="still")
    with pytest.raises(RegistrationError, match="fewer than 10 scans"):
        true_graph(few, None, 0, Workers(1))
