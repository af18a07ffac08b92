"""Rotation averaging: known answers, oracles, invariances, outliers, limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.experiments.averaging import errors
from benchmarks.experiments.view_graphs import view_graph
from miniloop_cli.averaging.rotations import average_rotations
from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry.se3 import exp_so3, rotation_angle_deg
from miniloop_cli.scene.view_graph import GraphError, components


def make(kind="video", scans=60, edges=250, outliers=0.0, noise_deg=0.0, seed=0):
    graph = view_graph(kind, scans, edges, outliers, noise_deg, 0.0, np.random.default_rng(seed))
    true = graph.T_world_cam[:, :3, :3]
    return graph, graph.T_j_i[:, :3, :3], true[0].T @ true


def worst_deg(R, true):
    return rotation_angle_deg(np.swapaxes(true, 1, 2) @ R).max()


@pytest.mark.slow
@pytest.mark.parametrize("start", ["votes", "tree"])
@pytest.mark.parametrize("kind", ["video", "expander"])
@pytest.mark.parametrize("scans", [2, 7, 60, 500])
def test_exact_edges_give_the_exact_rotations(start, kind, scans):
    graph, R_j_i, true = make(kind, scans, min(4 * scans, scans * (scans - 1) // 2))
    result = average_rotations(scans, graph.pairs, R_j_i, start=start)
    assert result.converged
    assert np.array_equal(result.R_world_cam[0], np.eye(3))
    assert worst_deg(result.R_world_cam, true) < 1e-5
    assert result.residual_deg.max() < 1e-5


def test_a_tree_of_edges_is_followed_exactly_also_through_half_turns():
    rng = np.random.default_rng(1)
    true = Rotation.random(30, random_state=rng).as_matrix()
    true[1] = true[0] @ np.diag([1.0, -1.0, -1.0])
    pairs = np.array([(max(0, k - 1 - k % 3), k) for k in range(1, 30)])
    i, j = pairs.T
    result = average_rotations(30, pairs, np.swapaxes(true[j], 1, 2) @ true[i])
    assert worst_deg(result.R_world_cam, true[0].T @ true) < 1e-5


def test_small_noise_agrees_with_scipy_on_the_same_robust_cost():
    graph, R_j_i, _ = make("expander", 15, 50, outliers=0.1, noise_deg=1.0)
    i, j = graph.pairs.T
    scale = np.radians(3.0)
    weights = np.random.default_rng(0).uniform(0.5, 2, 50)

    def geman_mcclure(x):
        R = exp_so3(np.vstack([np.zeros(3), x.reshape(-1, 3)])) @ result.R_world_cam
        r2 = np.radians(rotation_angle_deg(R[j] @ R_j_i @ np.swapaxes(R[i], 1, 2))) ** 2
        return np.sqrt(weights * r2 / (1 + r2 / scale**2))

    result = average_rotations(15, graph.pairs, R_j_i, weights, tolerance_deg=1e-7, irls_iterations=300)
    better = least_squares(geman_mcclure, np.zeros(42), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert np.degrees(np.abs(better.x)).max() < 0.01


@pytest.mark.parametrize(("kind", "limit"), [("video", 1.2), ("expander", 1.2)])
def test_fifteen_percent_of_gross_false_edges_do_no_harm(kind, limit):
    for seed in range(5):
        graph, R_j_i, _ = make(kind, 100, 2400, outliers=0.15, noise_deg=0.5, seed=seed)
        clean = ~graph.false
        robust = average_rotations(100, graph.pairs, R_j_i)
        best = average_rotations(100, graph.pairs[clean], R_j_i[clean])
        assert worst_deg(robust.R_world_cam, best.R_world_cam) < limit
        assert errors(graph, robust.R_world_cam, None)["rot_err_deg_mean"] < 0.5
        assert np.all(robust.residual_deg[clean] < 5)
        assert np.mean(robust.residual_deg[graph.false] > 9) > 0.98


@pytest.mark.parametrize(
    ("kind", "outliers", "share"), [("video", 0.1, 0.0), ("video", 0.3, 0.01), ("expander", 0.3, 0.02)]
)
def test_sparse_large_graphs_with_many_outliers(kind, outliers, share):
    """Five edges a scan. At 30 % some scans keep at most one true edge: these few nothing can save."""
    graph, R_j_i, _ = make(kind, 2000, 10000, outliers=outliers, noise_deg=0.5)
    result = average_rotations(2000, graph.pairs, R_j_i)
    i, j = graph.pairs.T
    true = np.swapaxes(graph.T_world_cam[j, :3, :3], 1, 2) @ graph.T_world_cam[i, :3, :3]
    mine = np.swapaxes(result.R_world_cam[j], 1, 2) @ result.R_world_cam[i]
    assert np.mean(rotation_angle_deg(np.swapaxes(true, 1, 2) @ mine) > 15) <= share
    assert errors(graph, result.R_world_cam, None)["rot_err_deg_median"] < 1.0
    assert result.converged


def test_the_voted_start_survives_what_the_tree_does_not():
    graph, R_j_i, _ = make("video", 1000, 5000, outliers=0.2, noise_deg=0.5)
    votes, tree = (average_rotations(1000, graph.pairs, R_j_i, start=start) for start in ("votes", "tree"))
    assert errors(graph, votes.R_world_cam, None)["rot_err_deg_median"] < 1.0
    assert errors(graph, tree.R_world_cam, None)["rot_err_deg_mean"] > 5.0


@settings(max_examples=20)
@given(seed=st.integers(0, 2**16))
def test_result_does_not_depend_on_numbering_direction_or_world(seed):
    graph, R_j_i, _ = make("expander", 25, 90, noise_deg=0.5, seed=seed)
    rng = np.random.default_rng(seed)
    reference = average_rotations(25, graph.pairs, R_j_i, tolerance_deg=1e-6, irls_iterations=200)
    order, flip, shuffle = rng.permutation(25), rng.random(90) < 0.5, rng.permutation(90)
    pairs = np.where(flip[:, None], order[graph.pairs][:, ::-1], order[graph.pairs])[shuffle]
    turned = np.where(flip[:, None, None], np.swapaxes(R_j_i, 1, 2), R_j_i)[shuffle]
    other = average_rotations(25, pairs, turned, tolerance_deg=1e-6, irls_iterations=200)
    back = other.R_world_cam[order]
    assert worst_deg(back[0].T @ back, reference.R_world_cam) < 1e-3
    np.testing.assert_allclose(other.residual_deg, reference.residual_deg[shuffle], atol=1e-3)


def test_weights_decide_between_edges_that_contradict():
    turn = exp_so3(np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.04]]))
    R = average_rotations(2, [(0, 1), (0, 1)], turn, [3.0, 1.0], scale_deg=1000.0, tolerance_deg=1e-8).R_world_cam
    np.testing.assert_allclose(R[1], exp_so3(np.array([0.0, 0.0, -0.025])), atol=1e-6)


def test_edges_of_weight_zero_are_reported_but_not_used():
    graph, R_j_i, true = make("expander", 20, 80)
    wrong = R_j_i.copy()
    wrong[-1] = wrong[-1] @ exp_so3(np.array([0.1, 0.0, 0.0]))
    weights = np.ones(80)
    weights[-1] = 0.0
    result = average_rotations(20, graph.pairs, wrong, weights)
    assert worst_deg(result.R_world_cam, true) < 1e-5
    assert result.residual_deg[-1] == pytest.approx(np.degrees(0.1), abs=1e-4)


@pytest.mark.parametrize("factor", [1e-12, 1e12])
def test_only_ratios_of_weights_matter(factor):
    graph, R_j_i, _ = make("video", 40, 150, outliers=0.1, noise_deg=1.0)
    weights = np.random.default_rng(0).uniform(10, 300, 150)
    one, two = (average_rotations(40, graph.pairs, R_j_i, w).R_world_cam for w in (weights, factor * weights))
    assert worst_deg(one, two) < 1e-4


def test_weights_over_twelve_magnitudes():
    graph, R_j_i, true = make("video", 400, 1600)
    weights = 10 ** np.random.default_rng(0).uniform(-6, 6, 1600)
    assert worst_deg(average_rotations(400, graph.pairs, R_j_i, weights).R_world_cam, true) < 1e-3


def test_one_scan_and_no_edge():
    result = average_rotations(1, np.empty((0, 2)), np.empty((0, 3, 3)))
    assert result.converged
    np.testing.assert_array_equal(result.R_world_cam, np.eye(3)[None])
    assert result.residual_deg.shape == (0,)


def test_same_input_same_bytes():
    graph, R_j_i, _ = make("video", 400, 1600, outliers=0.1, noise_deg=0.5)
    one, two = (average_rotations(400, graph.pairs, R_j_i) for _ in range(2))
    assert one.R_world_cam.tobytes() == two.R_world_cam.tobytes()


def test_inputs_are_left_alone():
    graph, R_j_i, _ = make("video", 30, 100, outliers=0.1)
    pairs, R, weights = graph.pairs.copy(), R_j_i.copy(), np.arange(1.0, 101.0)
    average_rotations(30, pairs, R, weights)
    assert (
        np.array_equal(pairs, graph.pairs) and np.array_equal(R, R_j_i) and np.array_equal(weights, np.arange(1, 101))
    )


@pytest.mark.parametrize(
    ("pairs", "weights", "said"),
    [
        ([(0, 1)], None, "2 components"),
        ([(0, 1), (1, 2)], [1.0, 0.0], "2 components"),
        ([(0, 1), (1, 3)], None, "edge 1 joins 1 and 3"),
        ([(0, 1), (2, 2)], None, "edge 1 joins 2 and 2"),
        ([(0, 1), (1, 2)], [1.0, -1.0], "edge 1 has weight -1"),
        ([(0, 1), (1, 2)], [1.0, np.nan], "edge 1 has weight nan"),
        ([(0, 1), (1, 2)], [1.0], "shape"),
    ],
)
def test_what_is_no_graph_is_said_so(pairs, weights, said):
    with pytest.raises(GraphError, match=said):
        average_rotations(3, pairs, np.eye(3)[None].repeat(len(pairs), axis=0), weights)


@pytest.mark.parametrize(
    ("R", "said"),
    [(np.full((1, 3, 3), np.nan), "edge 0 is not finite"), (-np.eye(3)[None], "not a rotation"), (np.eye(3), "shape")],
)
def test_what_is_no_rotation_is_said_so(R, said):
    with pytest.raises(GraphError, match=said):
        average_rotations(2, [(0, 1)], R)


def test_no_scan_and_unknown_start():
    with pytest.raises(GraphError, match="no scan"):
        average_rotations(0, np.empty((0, 2)), np.empty((0, 3, 3)))
    with pytest.raises(ConfigError, match="guess"):
        average_rotations(2, [(0, 1)], np.eye(3)[None], start="guess")


def test_components_are_numbered_by_size():
    labels = components(7, [(5, 6), (1, 2), (2, 4), (3, 1)])
    np.testing.assert_array_equal(labels, [2, 0, 0, 0, 0, 1, 1])
    assert components(0, np.empty((0, 2))).shape == (0,)


def test_no_worse_than_shonan_averaging():
    pytest.importorskip("gtsam")
    from benchmarks.experiments.peers.averaging import gtsam_rotations

    graph, R_j_i, _ = make("expander", 60, 300, noise_deg=1.0)
    mine = average_rotations(60, graph.pairs, R_j_i).R_world_cam
    theirs, _ = gtsam_rotations(graph)
    one, two = (errors(graph, R, None)["rot_err_deg_mean"] for R in (mine, theirs))
    assert one < 1.1 * two


def test_agrees_with_pycolmap_on_an_easy_graph():
    pytest.importorskip("pycolmap")
    from benchmarks.experiments.peers.averaging import pycolmap_rotations

    graph, R_j_i, _ = make("expander", 60, 300, outliers=0.05, noise_deg=0.5)
    mine = average_rotations(60, graph.pairs, R_j_i).R_world_cam
    theirs, _ = pycolmap_rotations(graph)
    one, two = (errors(graph, R, None)["rot_err_deg_mean"] for R in (mine, theirs))
    assert one < 1.1 * two
    assert worst_deg(mine, theirs[0].T @ theirs) < 1.5
