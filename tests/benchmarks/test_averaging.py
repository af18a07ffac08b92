"""The view graphs and `python -m benchmarks averaging`."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks
from benchmarks.experiments.averaging import errors, graph_rows
from benchmarks.experiments.view_graphs import view_graph
from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry.se3 import exp_so3, inverse, rotation_angle_deg
from miniloop_cli.scene.view_graph import components


@pytest.mark.parametrize("kind", ["video", "expander"])
@pytest.mark.parametrize(("scans", "edges"), [(2, 1), (30, 29), (30, 435), (100, 500), (1500, 6000)])
def test_graphs_are_connected_with_the_edges_asked_for(kind, scans, edges):
    graph = view_graph(kind, scans, edges, 0.0, 0.0, 0.0, np.random.default_rng(0))
    assert graph.pairs.shape == (edges, 2)
    assert len(np.unique(graph.pairs, axis=0)) == edges
    assert np.all(graph.pairs[:, 0] < graph.pairs[:, 1])
    assert components(scans, graph.pairs).max() == 0
    i, j = graph.pairs.T
    np.testing.assert_allclose(graph.T_j_i, inverse(graph.T_world_cam[j]) @ graph.T_world_cam[i], atol=1e-9)


def test_noise_and_outliers_are_as_stated():
    graph = view_graph("video", 2000, 10000, 0.2, 0.5, 0.01, np.random.default_rng(1))
    i, j = graph.pairs.T
    error = inverse(inverse(graph.T_world_cam[j]) @ graph.T_world_cam[i]) @ graph.T_j_i
    angle, distance = rotation_angle_deg(error[:, :3, :3]), np.linalg.norm(error[:, :3, 3], axis=1)
    assert graph.false.sum() == 2000
    assert np.sqrt(np.mean(angle[~graph.false] ** 2)) == pytest.approx(0.5 * np.sqrt(3), rel=0.03)
    assert np.sqrt(np.mean(distance[~graph.false] ** 2)) == pytest.approx(0.01 * np.sqrt(3), rel=0.03)
    assert np.median(angle[graph.false]) > 90
    assert components(2000, graph.pairs).max() == 0


def test_video_loops_join_near_and_similar_views():
    graph = view_graph("video", 3000, 15000, 0.0, 0.0, 0.0, np.random.default_rng(2))
    loops = np.diff(graph.pairs, axis=1)[:, 0] > 30
    assert 0.15 < loops.mean() < 0.25
    assert np.linalg.norm(graph.T_j_i[loops, :3, 3], axis=1).max() < 1.0
    assert rotation_angle_deg(graph.T_j_i[loops, :3, :3]).max() < 90


def test_errors_do_not_see_the_gauge():
    graph = view_graph("video", 50, 200, 0.0, 0.0, 0.0, np.random.default_rng(3))
    turn, shift = exp_so3(np.array([1.0, 2.0, -0.5])), np.array([3.0, -1.0, 7.0])
    R, t = turn @ graph.T_world_cam[:, :3, :3], graph.T_world_cam[:, :3, 3] @ turn.T + shift
    assert max(errors(graph, R, t).values()) < 1e-6
    R[::5] = R[::5] @ exp_so3(np.array([0.1, 0.0, 0.0]))
    found = errors(graph, R, t)
    assert found["rot_err_deg_median"] < 0.05
    assert found["rot_err_deg_mean"] == pytest.approx(np.degrees(0.1) / 5, abs=0.05)


@pytest.mark.parametrize(
    ("kind", "edges", "outliers"), [("photo", 20, 0.0), ("video", 8, 0.0), ("video", 46, 0.0), ("video", 20, 1.0)]
)
def test_impossible_graphs_are_refused(kind, edges, outliers):
    with pytest.raises(ConfigError):
        view_graph(kind, 10, edges, outliers, 0.0, 0.0, np.random.default_rng(0))


def test_the_certificate_is_that_of_the_true_edges():
    (row,) = graph_rows("video", 150, 750, 0.04, 0.5, 0.01, True, False, 0)
    assert row["proof_edges"] == 720 and row["certified"] and row["relative_gap"] <= 1e-4
    assert row["proof_cpu_seconds"] > 0


@pytest.mark.slow
def test_command_writes_rows_and_picture(tmp_path):
    arguments = "averaging --scans 100 --edges 600 --outliers 10 --kind expander --json - -q".split()
    result = CliRunner().invoke(benchmarks, [*arguments, "-o", str(tmp_path)])
    assert result.exit_code == 0, result.output
    (row,) = json.loads(result.stdout)["rows"]
    assert (row["scans"], row["edges"], row["outliers"], row["kind"]) == (100, 600, 0.1, "expander")
    assert row["converged"] is True
    assert 0 < row["rot_err_deg_median"] < 1 and row["rot_err_deg_mean"] < 2 and row["trans_err_median"] < 0.05
    assert row["seconds"] == pytest.approx(row["rotation_seconds"] + row["translation_seconds"])
    assert row["peak_mb"] > 10
    assert (tmp_path / "averaging.csv").read_text().count("\n") == 2
    assert (tmp_path / "averaging.png").read_bytes().startswith(b"\x89PNG")


def test_more_than_all_edges_false_is_wrong_usage(tmp_path):
    result = CliRunner().invoke(benchmarks, ["averaging", "--outliers", "150", "-o", str(tmp_path)])
    assert result.exit_code == 2
    assert "percent" in result.output
