"""The block system against dense linear algebra."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.refinement.block_cholesky import BlockPattern
from miniloop_cli.refinement.block_system import DENSE_UP_TO, MOST_STEPS, SMALL, BlockSystem


def random_system(rng, n, m, held_share=0.0, method=None):
    """A positive definite block matrix over random pairs, dense and as blocks."""
    pairs = rng.integers(0, n, (m, 2))
    held = rng.random(n) < held_share
    system = BlockSystem(held, pairs, method)
    M = np.zeros((n, 6, n, 6))
    for i, j in pairs:
        J = rng.standard_normal((6, 12))
        J[:, 6:] *= i != j
        H = (J.T @ J).reshape(2, 6, 2, 6)
        for a, x in enumerate((i, j)):
            for b, y in enumerate((i, j)):
                M[x, :, y, :] += H[a, :, b, :]
    M[np.arange(n), :, np.arange(n), :] += 0.1 * np.eye(6)
    return system, held, M, np.ascontiguousarray(M[system.rows, :, system.cols, :])


@pytest.mark.parametrize("method", ["dense", "sparse"])
@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(0, 80), st.sampled_from([0.0, 0.2]))
def test_solutions_and_marginals_are_those_of_numpy(method, seed, n, m, held_share):
    rng = np.random.default_rng(seed)
    system, held, M, blocks = random_system(rng, n, m, held_share, method)
    right = rng.standard_normal((n, 6))
    x, Z = system.solve(blocks, right), system.marginals(blocks)
    free = np.flatnonzero(~held)
    inner = M[free][:, :, free].reshape(6 * len(free), 6 * len(free))
    expected = np.zeros((n, 6))
    expected[free] = np.linalg.solve(inner, right[free].ravel()).reshape(-1, 6)
    np.testing.assert_allclose(x, expected, rtol=1e-7, atol=1e-9)
    inverse = np.linalg.inv(inner).reshape(len(free), 6, len(free), 6)
    np.testing.assert_allclose(Z[free], inverse[np.arange(len(free)), :, np.arange(len(free))], rtol=1e-7, atol=1e-9)
    assert not Z[held].any()


def test_where_most_see_each_other_gradients_give_the_same_solution():
    right = np.random.default_rng(3).standard_normal((60, 6))

    def solution(method):
        system, _, _, blocks = random_system(np.random.default_rng(4), 60, 5000, 0.1, method)
        return system.solve(blocks, right)

    direct, found = solution("dense"), solution("gradients")
    np.testing.assert_allclose(found, direct, atol=1e-5 * np.abs(direct).max())
    assert (found != direct).any(), "the dense factor was asked"


def test_gradients_that_do_not_settle_are_replaced():
    """What pulls at one end of a chain is felt one pose farther a step."""
    n = MOST_STEPS + 100
    pairs = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    direct, system = (BlockSystem(np.zeros(n, bool), pairs, method) for method in ("dense", "gradients"))
    blocks = np.concatenate([np.tile((2 + 1e-6) * np.eye(6), (n, 1, 1)), np.tile(-np.eye(6), (n - 1, 1, 1))])
    right = np.zeros((n, 6))
    right[0] = 1
    np.testing.assert_array_equal(system.solve(blocks, right), direct.solve(blocks, right))


def test_gradients_of_a_matrix_that_is_not_positive_definite_are_not_believed():
    rng = np.random.default_rng(4)
    system, _, _, blocks = random_system(rng, 40, 900, method="gradients")
    blocks[40:] *= 50
    with pytest.raises(np.linalg.LinAlgError):
        system.solve(blocks, rng.standard_normal((40, 6)))


@pytest.mark.parametrize(
    ("n", "reach", "method"),
    [
        (SMALL, 1, "dense"),
        (SMALL + 1, 1, "sparse"),
        (DENSE_UP_TO, DENSE_UP_TO // 2, "dense"),
        (DENSE_UP_TO + 1, 1, "sparse"),
        (DENSE_UP_TO + 1, DENSE_UP_TO // 2, "gradients"),
    ],
)
def test_the_method_follows_the_pattern(n, reach, method):
    i, j = np.triu_indices(n, 1)
    assert BlockSystem(np.zeros(n, bool), np.stack([i, j], axis=1)[j - i <= reach]).method == method
    more = np.arange(2 * n) >= n  # those that are held do not count
    assert BlockSystem(more, np.stack([i, j], axis=1)[j - i <= reach]).method == method


@pytest.mark.parametrize("reach", [3, 20, 119])
def test_the_products_of_a_factorisation_are_those_of_its_columns(reach):
    """A band fills in nowhere: each column has `reach` blocks below the diagonal, the last ones fewer."""
    n = 120
    i, j = np.triu_indices(n)
    near = j - i <= reach
    pattern = BlockPattern(n, i[near], j[near])
    below = np.minimum(reach, n - 1 - np.arange(n))
    assert (216 * (below**2).sum()) == pytest.approx(
        pattern.products, rel=0.25
    )  # minimum degree may do a little better


def test_block_numbers_in_either_order():
    system = BlockSystem(np.zeros(4, bool), np.array([[2, 0], [1, 3], [0, 2], [3, 3]]))
    assert list(zip(system.rows.tolist(), system.cols.tolist(), strict=True)) == [
        (0, 0), (1, 1), (2, 2), (3, 3), (0, 2), (1, 3)
    ]  # fmt: skip
    assert system.block_of(np.array([2, 3]), np.array([0, 1])).tolist() == [4, 5]
    index = system.index()
    assert index.start.tolist() == [4, 5, 6, 6, 6]
    assert index.columns.tolist() == [0, 1, 2, 3, 2, 3]


@pytest.mark.parametrize("n", [5, 400])
def test_says_when_not_positive_definite(n):
    pairs = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    system = BlockSystem(np.zeros(n, bool), pairs)
    blocks = np.zeros((len(system), 6, 6))
    blocks[:n] = np.eye(6)
    blocks[n:] = -np.eye(6)  # a chain's matrix with diagonal 1 instead of 2
    with pytest.raises(np.linalg.LinAlgError):
        system.solve(blocks, np.ones((n, 6)))
