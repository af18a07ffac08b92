"""The proof that an arrangement of edges is the best one: what it accepts, what it refuses, and the way out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.averaging.certificate import bound, escaped
from miniloop_cli.averaging.quadratic_form import EdgeWeights, QuadraticForm
from miniloop_cli.averaging.stiefel import best_translations, cost, minimise, multipliers
from miniloop_cli.geometry import se3

PAIRS = [(0, 1), (1, 2), (2, 3), (3, 4), (0, 4), (0, 2), (1, 3), (2, 4)]


def noise(rng, count, rad, m):
    return se3.pose(se3.exp_so3(rng.normal(0, rad, (count, 3))), rng.normal(0, m, (count, 3)))


def weights(count, kappa=1.0, tau=1.0, c_i=0.0):
    return EdgeWeights(np.full(count, kappa), np.full(count, tau), np.full((count, 3), c_i))


def ring(n, turns, rng=None, rad=0.01):
    """A form whose best poses do not turn at all, and poses that turn round the ring `turns` times."""
    pairs = np.stack([np.arange(n), (np.arange(n) + 1) % n], axis=1)
    T_j_i = np.tile(np.eye(4), (n, 1, 1)) if rng is None else noise(rng, n, rad, rad / 10)
    turned = se3.exp_so3(2 * np.pi * turns / n * np.arange(n)[:, None] * [0.0, 0.6, 0.8])
    form = QuadraticForm.of(n, pairs, T_j_i, weights(n))
    return form, form.rows(se3.pose(turned, np.zeros((n, 3))))


def scattered(rng, pairs, count, rad=0.1, m=0.1):
    """A form of noisy edges between random poses, and these poses."""
    pairs = np.array(pairs)
    T = se3.pose(se3.exp_so3(rng.normal(size=(count, 3))), rng.normal(size=(count, 3)))
    exact = se3.inverse(T[pairs[:, 1]]) @ T[pairs[:, 0]]
    w = EdgeWeights(rng.uniform(1, 9, len(pairs)), rng.uniform(1, 9, len(pairs)), rng.normal(size=(len(pairs), 3)))
    T_j_i = noise(rng, len(pairs), rad, m) @ exact
    return QuadraticForm.of(count, pairs, T_j_i, w), T, T_j_i, w


def dense_S(form, Y):
    """S with its translations eliminated, by dense algebra, and without the signs of any factor."""
    Q, n = form.Q.toarray(), form.count
    t = np.arange(3, 4 * n, 4)
    r = np.setdiff1d(np.arange(4 * n), t)
    S = Q[np.ix_(r, r)] - Q[np.ix_(r, t)] @ np.linalg.pinv(Q[np.ix_(t, t)]) @ Q[np.ix_(t, r)]
    for k, block in enumerate(multipliers(form, best_translations(form, Y))):
        S[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] -= block
    return S


def test_the_form_is_the_cost_of_the_edges(rng):
    form, T, T_j_i, w = scattered(rng, PAIRS, 5)
    i, j = np.array(PAIRS).T
    moved = noise(rng, 5, 0.5, 0.5) @ T
    off = moved[i] - moved[j] @ T_j_i
    at_c = np.einsum("mab,mb->ma", off, np.concatenate([w.c_i, np.ones((8, 1))], axis=1))[:, :3]
    expected = (w.kappa * (off[:, :3, :3] ** 2).sum((1, 2)) + w.tau * (at_c**2).sum(1)).sum()
    np.testing.assert_allclose(cost(form, form.rows(moved)), expected, rtol=1e-12)
    np.testing.assert_allclose(form.poses(form.rows(moved)), moved)


@pytest.mark.parametrize("n", [20, 100, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("noisy", [False, True])
def test_a_ring_with_one_turn_too_many_is_refused_and_left(n, noisy):
    make_noise = np.random.default_rng(n) if noisy else None
    form, wound = ring(n, 1, make_noise)
    stuck = minimise(form, wound).Y
    found = bound(form, stuck)
    assert not found.certified and found.way_out is not None
    better = bound(form, escaped(form, stuck, found.way_out))
    assert better.certified and better.cost < 0.1 * found.cost

    straight, start = ring(n, 0, np.random.default_rng(n) if noisy else None)
    right = bound(straight, minimise(straight, start).Y)
    assert right.certified and right.way_out is None
    np.testing.assert_allclose(better.cost, right.cost, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("disturbed", [5e-4, 1e-3, 3e-3])
def test_the_bound_is_that_of_the_lowest_eigenvalue(disturbed, rng):
    """Of poses off their minimum; within the percent that is added to an eigenvalue that iterations found."""
    form, T, *_ = scattered(rng, PAIRS, 5)
    least = form.poses(minimise(form, form.rows(T)).Y)
    Y = form.rows(least @ noise(rng, 5, disturbed, disturbed))
    lowest = float(np.linalg.eigvalsh(dense_S(form, Y))[0])
    found = bound(form, Y)
    promised = 15 * -lowest / found.cost
    assert 0 < promised < 1 and promised <= found.gap <= 1.02 * promised
    rayleigh = found.way_out.ravel() @ dense_S(form, Y) @ found.way_out.ravel()
    np.testing.assert_allclose(rayleigh, lowest, rtol=1e-3)


def test_what_is_certified_has_no_negative_eigenvalue():
    form, Y = ring(24, 0, np.random.default_rng(3), rad=0.05)
    best = minimise(form, Y).Y
    found = bound(form, best)
    assert found.certified and np.linalg.eigvalsh(dense_S(form, best))[0] > -found.gap * found.cost / 72


@pytest.mark.slow
@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_no_arrangement_is_better_than_the_bound_says(seed, disturbed):
    """Also where the descent has not converged, or not even begun."""
    rng = np.random.default_rng(seed)
    form, T, *_ = scattered(rng, PAIRS, 5)
    Y = form.rows(noise(rng, 5, disturbed, disturbed) @ T)
    found = bound(form, Y)
    least = min(minimise(form, form.rows(noise(rng, 5, 1.0, 1.0) @ T)).cost for _ in range(3))
    assert least >= found.cost * (1 - found.gap) - 1e-9 * found.cost


def test_exact_edges_leave_nothing_to_gain(rng):
    form, T, *_ = scattered(rng, PAIRS, 5, 0.0, 0.0)
    assert bound(form, form.rows(T)).gap == 0


def test_translations_follow_from_rotations(rng):
    form, T, *_ = scattered(rng, PAIRS, 5)
    Y = best_translations(form, form.rows(T))
    assert np.abs(form.times(Y)[:, 3]).max() < 1e-12
    assert cost(form, Y) < cost(form, form.rows(T))


def test_minimum_has_no_gradient_and_is_found_again_from_afar(rng):
    form, T, *_ = scattered(rng, PAIRS, 5)
    near, far = minimise(form, form.rows(T)), minimise(form, form.rows(noise(rng, 5, 0.5, 1.0) @ T))
    np.testing.assert_allclose(far.cost, near.cost, rtol=1e-9)
    S_Y = dense_S(form, near.Y) @ near.Y[:, :3].reshape(15, 3)
    assert np.abs(S_Y).max() < 1e-4 * near.cost


def test_isotropic_weights_are_those_of_the_matches_about_their_middle(rng):
    """Matches with equal noise sigma: their middle, and 1 / sigma^2 a match; rotation by their scatter."""
    T_j_i = noise(rng, 1, 1.0, 1.0)
    p_i, sigma = rng.normal([0.5, -0.2, 2.0], 1.0, (4000, 3)), 0.01
    p_j = se3.transform(T_j_i[0], p_i)
    J = np.concatenate([-se3.hat(p_j), np.tile(np.eye(3), (len(p_j), 1, 1))], axis=2)  # d(w x p + v)
    information = np.einsum("kab,kac->bc", J, J)[None] / sigma**2
    found = EdgeWeights.of(T_j_i, information)
    np.testing.assert_allclose(found.c_i[0], p_i.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(found.tau, len(p_i) / sigma**2, rtol=1e-9)
    about = -se3.hat(p_j - p_j.mean(axis=0))
    of_rotation = np.einsum("kab,kac->bc", about, about) / sigma**2
    np.testing.assert_allclose(found.kappa, 1.5 / np.trace(np.linalg.inv(of_rotation)), rtol=1e-9)


def test_information_that_leaves_something_open_gives_finite_weights():
    """Matches on a line say nothing of the turn about it, and no matches nothing at all."""
    line = np.array([[0.0, 0, 1], [0, 0, 2], [0, 0, 3]])
    J = np.concatenate([-se3.hat(line), np.tile(np.eye(3), (3, 1, 1))], axis=2)
    information = np.stack([1e4 * np.einsum("kab,kac->bc", J, J), np.zeros((6, 6)), np.eye(6)])
    found = EdgeWeights.of(np.tile(np.eye(4), (3, 1, 1)), information).times(np.ones(3), np.ones(3))
    assert np.isfinite(found.c_i).all() and (found.kappa > 0).all() and (found.tau > 0).all()
    assert found.kappa[0] < 1e-3 * found.tau[0] and np.isfinite(found.kappa).all()


@pytest.mark.parametrize("turns", [0, 1])
@pytest.mark.parametrize("n", [6, 20])
def test_rings_against_gtsam(n, turns):
    """Small ones: at 100 poses gtsam's own check takes the zeros of the free origin for the lowest eigenvalue."""
    form, Y = ring(n, turns)
    pairs = np.stack([np.arange(n), (np.arange(n) + 1) % n], axis=1)
    R = form.poses(Y)[:, :3, :3]
    assert bound(form, Y).certified == gtsam_says_optimal(pairs, np.tile(np.eye(3), (n, 1, 1)), R) == (turns == 0)


@pytest.mark.parametrize("seed", range(5))
def test_random_graphs_against_gtsam(seed):
    rng, ones = np.random.default_rng(seed), np.ones(len(PAIRS))
    _, T, T_j_i, _ = scattered(rng, PAIRS, 5, rad=0.3)
    only_rotations = EdgeWeights(ones, 1e-9 * ones, np.zeros((len(ones), 3)))
    form = QuadraticForm.of(5, np.array(PAIRS), T_j_i, only_rotations)
    for start in (T, noise(rng, 5, 0.5, 0.0) @ T):
        Y = minimise(form, form.rows(start)).Y
        assert bound(form, Y).certified == gtsam_says_optimal(PAIRS, T_j_i[:, :3, :3], form.poses(Y)[:, :3, :3])


def gtsam_says_optimal(pairs, R_j_i, R_world_cam):
    gtsam = pytest.importorskip("gtsam", reason="gtsam is not installed: nothing to compare the certificate with")
    model = gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
    measured = [
        gtsam.BinaryMeasurementRot3(int(j), int(i), gtsam.Rot3(R), model)
        for (i, j), R in zip(pairs, R_j_i, strict=True)
    ]
    values = gtsam.Values()
    for k, R in enumerate(R_world_cam):
        values.insert(k, gtsam.SOn.FromMatrix(R))
    parameters = gtsam.ShonanAveragingParameters3(gtsam.LevenbergMarquardtParams.CeresDefaults())
    return gtsam.ShonanAveraging3(measured, parameters).checkOptimality(values)
