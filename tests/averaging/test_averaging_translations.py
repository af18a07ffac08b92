"""Translation averaging: known answers, oracles, invariances, outliers, limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.experiments.view_graphs import view_graph
from miniloop_cli.averaging.translations import average_translations
from miniloop_cli.geometry.se3 import exp_so3
from miniloop_cli.scene.view_graph import GraphError


def make(kind="video", scans=60, edges=250, outliers=0.0, noise_m=0.0, seed=0):
    """Graph, rotations and true translations, both with the first scan at the identity."""
    graph = view_graph(kind, scans, edges, outliers, 0.0, noise_m, np.random.default_rng(seed))
    R, t = graph.T_world_cam[:, :3, :3], graph.T_world_cam[:, :3, 3]
    return graph, R[0].T @ R, (t - t[0]) @ R[0]


@pytest.mark.parametrize("robust", [True, False])
@pytest.mark.parametrize("kind", ["video", "expander"])
@pytest.mark.parametrize("scans", [2, 7, 60, 500])
def test_exact_edges_give_the_exact_translations(robust, kind, scans):
    graph, R, true = make(kind, scans, min(4 * scans, scans * (scans - 1) // 2))
    result = average_translations(R, graph.pairs, graph.T_j_i[:, :3, 3], robust=robust)
    assert result.converged
    assert np.all(result.t_world_cam[0] == 0)
    np.testing.assert_allclose(result.t_world_cam, true, atol=1e-7)
    assert result.residual_m.max() < 1e-7


def test_plain_variant_is_weighted_least_squares():
    graph, R, _ = make("expander", 20, 70, noise_m=0.05)
    weights = np.random.default_rng(0).integers(10, 200, 70).astype(float)
    i, j = graph.pairs.T
    A = np.zeros((70, 20))
    A[np.arange(70), i], A[np.arange(70), j] = 1, -1
    d = np.einsum("eab,eb->ea", R[j], graph.T_j_i[:, :3, 3])
    root = np.sqrt(weights)[:, None]
    expected = np.linalg.lstsq(root * A[:, 1:], root * d, rcond=None)[0]
    result = average_translations(R, graph.pairs, graph.T_j_i[:, :3, 3], weights, robust=False)
    np.testing.assert_allclose(result.t_world_cam[1:], expected, atol=1e-10)
    np.testing.assert_allclose(result.residual_m, np.linalg.norm(d - A[:, 1:] @ expected, axis=1), atol=1e-10)


def test_plain_variant_satisfies_the_point_matches_best():
    """Means of R_j q - R_i p, weighted by their number, are all that least squares over every match needs."""
    graph, R, _ = make("expander", 8, 16)
    rng = np.random.default_rng(1)
    counts = rng.integers(3, 40, 16)
    p_world = [rng.standard_normal((k, 3)) for k in counts]  # R_i p of every match
    q_world = [p + rng.standard_normal((1, 3)) + 0.1 * rng.standard_normal(p.shape) for p in p_world]
    b = np.array([(q - p).mean(0) for p, q in zip(p_world, q_world, strict=True)])
    t_j_i = np.einsum("eba,eb->ea", R[graph.pairs[:, 1]], b)
    t = average_translations(R, graph.pairs, t_j_i, counts, robust=False).t_world_cam

    rows, rhs = [], []
    for (i, j), p, q in zip(graph.pairs, p_world, q_world, strict=True):
        row = np.zeros((len(p), 8))
        row[:, i], row[:, j] = 1, -1
        rows.append(row)
        rhs.append(q - p)
    expected = np.linalg.lstsq(np.concatenate(rows)[:, 1:], np.concatenate(rhs), rcond=None)[0]
    np.testing.assert_allclose(t[1:], expected, atol=1e-9)


def test_fixed_point_is_that_of_the_cauchy_cost():
    """At the result, the gradient of sum w log(1 + (r / s)^2) vanishes for every scan."""
    graph, R, _ = make("expander", 20, 80, outliers=0.1, noise_m=0.02)
    weights = np.random.default_rng(0).uniform(0.5, 2, 80)
    result = average_translations(R, graph.pairs, graph.T_j_i[:, :3, 3], weights, reweights=200)
    i, j = graph.pairs.T
    t = result.t_world_cam
    r = np.einsum("eab,eb->ea", R[j], graph.T_j_i[:, :3, 3]) - (t[i] - t[j])
    pull = (weights / (1 + (r * r).sum(1) / 0.03**2))[:, None] * r
    gradient, size = np.zeros((20, 3)), np.zeros((20, 3))
    for scan, sign in ((i, 1), (j, -1)):
        np.add.at(gradient, scan, sign * pull)
        np.add.at(size, scan, np.abs(pull))
    assert np.abs(gradient).max() < 0.005 * size.max()


@pytest.mark.parametrize("kind", ["video", "expander"])
def test_fifteen_percent_of_gross_false_edges_do_no_harm(kind):
    for seed in range(5):
        graph, R, true = make(kind, 100, 2400, outliers=0.15, noise_m=0.01, seed=seed)
        robust = average_translations(R, graph.pairs, graph.T_j_i[:, :3, 3])
        plain = average_translations(R, graph.pairs, graph.T_j_i[:, :3, 3], robust=False)
        assert np.linalg.norm(robust.t_world_cam - true, axis=1).max() < 0.03
        assert np.linalg.norm(plain.t_world_cam - true, axis=1).max() > 0.1
        assert robust.residual_m[~graph.false].max() < 0.1


def test_large_graph_with_outliers():
    graph, R, true = make("video", 2000, 10000, outliers=0.2, noise_m=0.01)
    result = average_translations(R, graph.pairs, graph.T_j_i[:, :3, 3])
    offset = result.t_world_cam - true
    assert np.median(np.linalg.norm(offset - np.median(offset, axis=0), axis=1)) < 0.05


@settings(max_examples=20)
@given(seed=st.integers(0, 2**16))
def test_turning_the_world_and_renumbering_change_nothing(seed):
    graph, R, _ = make("expander", 25, 90, noise_m=0.01, seed=seed)
    rng = np.random.default_rng(seed)
    t_j_i = graph.T_j_i[:, :3, 3]
    reference = average_translations(R, graph.pairs, t_j_i, reweights=100).t_world_cam
    turn = exp_so3(rng.standard_normal(3))
    turned = average_translations(turn @ R, graph.pairs, t_j_i, reweights=100).t_world_cam
    np.testing.assert_allclose(turned, reference @ turn.T, atol=1e-3)
    order, shuffle = rng.permutation(25), rng.permutation(90)
    R_other = np.empty_like(R)
    R_other[order] = R
    other = average_translations(R_other, order[graph.pairs][shuffle], t_j_i[shuffle], reweights=100).t_world_cam
    np.testing.assert_allclose(other[order] - other[order[0]], reference, atol=1e-3)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_any_unit_of_length(scale):
    graph, R, _ = make("video", 400, 1600, outliers=0.1, noise_m=0.01)
    one = average_translations(R, graph.pairs, graph.T_j_i[:, :3, 3])
    other = average_translations(R, graph.pairs, scale * graph.T_j_i[:, :3, 3], scale_m=0.03 * scale)
    np.testing.assert_allclose(other.t_world_cam / scale, one.t_world_cam, atol=1e-6)


def test_zero_weights_are_left_out_and_reported():
    graph, R, true = make("expander", 20, 80)
    t_j_i, weights = graph.T_j_i[:, :3, 3].copy(), np.ones(80)
    t_j_i[-1] += [0.05, 0.0, 0.0]
    weights[-1] = 0.0
    result = average_translations(R, graph.pairs, t_j_i, weights)
    np.testing.assert_allclose(result.t_world_cam, true, atol=1e-7)
    assert result.residual_m[-1] == pytest.approx(0.05, abs=1e-6)


def test_one_scan():
    for robust in (True, False):
        result = average_translations(np.eye(3)[None], np.empty((0, 2)), np.empty((0, 3)), robust=robust)
        np.testing.assert_array_equal(result.t_world_cam, np.zeros((1, 3)))
        assert result.converged


def test_what_is_no_graph_is_said_so():
    R = np.eye(3)[None].repeat(3, axis=0)
    with pytest.raises(GraphError, match="2 components"):
        average_translations(R, [(0, 1)], np.zeros((1, 3)))
    with pytest.raises(GraphError, match="the translation of edge 0 is not finite"):
        average_translations(R, [(0, 1), (1, 2)], np.full((2, 3), np.inf))
    with pytest.raises(GraphError, match=r"2 edges need translations of shape \(2, 3\), got \(1, 3\)"):
        average_translations(R, [(0, 1), (1, 2)], np.zeros((1, 3)))
    with pytest.raises(GraphError, match="no scan"):
        average_translations(np.empty((0, 3, 3)), np.empty((0, 2)), np.empty((0, 3)))
