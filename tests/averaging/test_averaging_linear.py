"""The linear solver against dense and sparse oracles, and the sampled elimination on what it must be exact for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.linalg import lsqr

from benchmarks.experiments.view_graphs import view_graph
from miniloop_cli.averaging.approximate_cholesky import apply, eliminate
from miniloop_cli.averaging.laplacian import DENSE_SCANS, Differences


def graph_pairs(kind, scans, edges, seed=0):
    return view_graph(kind, scans, edges, 0.1, 0.5, 0.01, np.random.default_rng(seed)).pairs


def incidence(scans, pairs):
    A = np.zeros((len(pairs), scans))
    A[np.arange(len(pairs)), pairs[:, 0]] = 1
    A[np.arange(len(pairs)), pairs[:, 1]] = -1
    return A


@pytest.mark.slow
@pytest.mark.parametrize("scans", [2, 50, DENSE_SCANS, DENSE_SCANS + 1, 700])
@pytest.mark.parametrize("kind", ["video", "expander"])
def test_solution_is_that_of_dense_least_squares(kind, scans):
    pairs = graph_pairs(kind, scans, min(4 * scans, scans * (scans - 1) // 2))
    rng = np.random.default_rng(1)
    weights, d = 10 ** rng.uniform(-2, 2, len(pairs)), rng.standard_normal((len(pairs), 3))
    root = np.sqrt(weights)[:, None]
    expected = np.linalg.lstsq(root * incidence(scans, pairs)[:, 1:], root * d, rcond=None)[0]
    x = Differences(scans, pairs).solve(weights, d, tolerance=1e-12)
    assert np.all(x[0] == 0)
    np.testing.assert_allclose(x[1:], expected, atol=1e-8)


def test_large_graph_agrees_with_lsqr_and_tolerance_is_kept():
    from scipy.sparse import coo_array

    scans = 3000
    pairs = graph_pairs("expander", scans, 12000)
    rng = np.random.default_rng(2)
    weights, d = rng.uniform(0.1, 10, len(pairs)), rng.standard_normal((len(pairs), 3))
    rows = np.arange(len(pairs))
    values = np.sqrt(np.concatenate([weights, weights])) * np.repeat([1.0, -1.0], len(pairs))
    A = coo_array((values, (np.concatenate([rows, rows]), pairs.T.ravel())), shape=(len(pairs), scans)).tocsr()
    expected = np.column_stack([lsqr(A, np.sqrt(weights) * c, atol=1e-13, btol=1e-13)[0] for c in d.T])
    system = Differences(scans, pairs)
    np.testing.assert_allclose(system.solve(weights, d, 1e-12), expected - expected[0], atol=1e-7)
    rough = system.solve(weights, d, 1e-2) - system.solve(weights, d, 1e-12)
    energy = np.sqrt((weights * ((rough[pairs[:, 0]] - rough[pairs[:, 1]]) ** 2).T).sum())
    size = np.sqrt((weights * ((expected[pairs[:, 0]] - expected[pairs[:, 1]]) ** 2).T).sum())
    assert energy < 0.05 * size


@pytest.mark.parametrize("scans", [100, 1000])
def test_weights_over_many_magnitudes_leave_no_nan(scans):
    pairs = graph_pairs("video", scans, 5 * scans)
    weights = 10 ** np.random.default_rng(3).uniform(-200, 100, len(pairs))
    true = np.random.default_rng(4).standard_normal((scans, 3))
    x = Differences(scans, pairs).solve(weights, true[pairs[:, 0]] - true[pairs[:, 1]], 1e-13)
    np.testing.assert_allclose(x, true - true[0], atol=1e-4)


def test_elimination_of_a_tree_is_exact():
    """A tree has no fill, so that nothing is sampled away: one application of the factor solves the system."""
    rng = np.random.default_rng(5)
    scans = 200
    pairs = np.column_stack([[rng.integers(k) for k in range(1, scans)], np.arange(1, scans)])
    weights = rng.uniform(0.1, 10, len(pairs))
    A = incidence(scans, pairs)
    b = A.T @ rng.standard_normal((len(pairs), 3))
    z = b.astype(np.float32)
    apply(*eliminate(scans, pairs, weights, rng.random(100)), z)
    np.testing.assert_allclose(A.T @ (weights[:, None] * (A @ z)), b, atol=1e-6 * np.abs(b).max())  # single precision


def test_elimination_is_right_on_average():
    """The expectation of the sampled L D L' is the Laplacian itself (Kyng & Sachdeva 2016)."""
    scans = 6
    pairs = np.array([(i, j) for i in range(scans) for j in range(i + 1, scans)])
    weights = np.random.default_rng(6).uniform(0.5, 2, len(pairs))
    A = incidence(scans, pairs)
    total, rounds = np.zeros((scans, scans)), 4000
    for seed in range(rounds):
        order, start, row, value, D = eliminate(scans, pairs, weights, np.random.default_rng(seed).random(997))
        row = np.argsort(order)[row]
        L = np.eye(scans)
        for c in range(scans):
            L[row[start[c] : start[c + 1]], c] = -value[start[c] : start[c + 1]]
        M = np.empty((scans, scans))
        M[np.ix_(order, order)] = L @ np.diag(D) @ L.T
        total += M
    np.testing.assert_allclose(total / rounds, A.T @ np.diag(weights) @ A, atol=0.1)


@settings(max_examples=25)
@given(scans=st.integers(2, 40), extra=st.integers(0, 60), seed=st.integers(0, 2**16))
def test_parallel_edges_and_random_graphs(scans, extra, seed):
    rng = np.random.default_rng(seed)
    tree = np.column_stack([(rng.random(scans - 1) * np.arange(1, scans)).astype(int), np.arange(1, scans)])
    more = rng.integers(0, scans, (extra, 2))
    pairs = np.concatenate([tree, more[more[:, 0] != more[:, 1]]]).astype(np.int64)
    true, weights = rng.standard_normal((scans, 3)), rng.uniform(0.1, 1, len(pairs))
    d = true[pairs[:, 0]] - true[pairs[:, 1]]
    small, large = Differences(scans, pairs), Differences(DENSE_SCANS + 1, extended(scans, pairs))
    np.testing.assert_allclose(small.solve(weights, d), true - true[0], atol=1e-9)
    chain = DENSE_SCANS + 1 - scans
    x = large.solve(np.concatenate([weights, np.ones(chain)]), np.concatenate([d, np.zeros((chain, 3))]), 1e-13)
    np.testing.assert_allclose(x[:scans], true - true[0], atol=1e-8)


def extended(scans, pairs):
    """The same graph with a chain hung on, so that it is large."""
    chain = np.column_stack([np.arange(scans - 1, DENSE_SCANS), np.arange(scans, DENSE_SCANS + 1)])
    return np.concatenate([pairs, chain])


def test_one_system_serves_weights_that_change_little_and_much():
    """The preconditioner of earlier weights is kept while it serves; the solutions must not tell."""
    scans = 800
    pairs = graph_pairs("video", scans, 4000)
    rng = np.random.default_rng(7)
    kept, d, weights = Differences(scans, pairs), rng.standard_normal((4000, 3)), np.ones(4000)
    for change in (0.0, 0.1, 0.1, 6.0, 0.5, 12.0):
        weights = weights * 10 ** (change * rng.uniform(-0.5, 0.5, 4000))
        fresh = Differences(scans, pairs).solve(weights, d, 1e-11)
        np.testing.assert_allclose(kept.solve(weights, d, 1e-11), fresh, atol=1e-5 * np.abs(fresh).max())
