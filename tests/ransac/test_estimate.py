"""The robust estimator against planted truth: pairs, cycles of 3 to 7 scans, known vertical."""

import numpy as np
import pytest

from miniloop_cli.bench.problems import noisy_cycle
from miniloop_cli.config import Ransac
from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.procrustes import align_points
from miniloop_cli.ransac.estimate import estimate
from miniloop_cli.ransac.matches import EdgeMatches
from miniloop_cli.runtime.parallel import Workers

CHI2 = 16.0
CASES = [(n, False) for n in range(2, 8)] + [(n, True) for n in (2, 3, 4)]
SIGMA_M = 0.005


def run(edges, seed=0, upright=False, **settings):
    return estimate(edges, Ransac(**settings), CHI2, np.random.default_rng(seed), upright)


def perturbation(T, truth):
    """(w, v) with T = [exp(w) | v] truth."""
    R = T[:3, :3] @ truth[:3, :3].T
    return np.concatenate([se3.log_so3(R), T[:3, 3] - R @ truth[:3, 3]])


@pytest.mark.parametrize(("scans", "upright"), CASES)
def test_planted_truth_is_found_among_wrong_matches(scans, upright):
    for seed in range(3):
        edges, T = noisy_cycle(np.random.default_rng(seed), scans, 60, 0.35, SIGMA_M, upright)
        found = run(edges, seed, upright)
        assert len(found.edges) == len(T) and found.hypotheses <= 2000
        for edge, matches, truth in zip(found.edges, edges, T, strict=True):
            w_v = perturbation(edge.T, truth)
            assert np.linalg.norm(w_v[:3]) < 0.006 and np.linalg.norm(w_v[3:]) < 0.015
            right = np.linalg.norm(se3.transform(truth, matches.p) - matches.q, axis=1) < 5 * SIGMA_M
            assert (edge.inliers == right).mean() > 0.95 and edge.inliers.sum() > 0.5 * len(right)
            assert (edge.inliers == (edge.chi2 < CHI2)).all()
            if upright:
                np.testing.assert_allclose(edge.T[2, :3], [0, 0, 1], atol=1e-9)


@pytest.mark.parametrize("scans", [3, 4, 5])
def test_the_closing_edge_is_the_product_of_the_chain(scans):
    edges, _ = noisy_cycle(np.random.default_rng(1), scans, 60, 0.2)
    *chain, closing = (edge.T for edge in run(edges).edges)
    whole = np.eye(4)
    for T in chain:
        whole = T @ whole
    np.testing.assert_allclose(closing, whole, atol=1e-12)


@pytest.mark.parametrize("scans", [3, 5])
def test_a_cycle_is_more_exact_than_its_edges_alone(scans):
    alone, joint = [], []
    for seed in range(25):
        edges, T = noisy_cycle(np.random.default_rng(seed), scans, 30, 0.2, 0.01)
        for matches, edge, truth in zip(edges, run(edges, seed).edges, T, strict=True):
            joint.append(np.linalg.norm(perturbation(edge.T, truth)[:3]))
            alone.append(np.linalg.norm(perturbation(run([matches], seed).edges[0].T, truth)[:3]))
    # n equal edges share one condition: variances fall to (n - 1) / n.
    assert np.mean(np.square(joint)) / np.mean(np.square(alone)) == pytest.approx((scans - 1) / scans, abs=0.12)


@pytest.mark.parametrize("scans", [2, 3, 4])
def test_covariances_are_those_of_repeated_noise(scans):
    rng = np.random.default_rng(5)
    edges, T = noisy_cycle(rng, scans, 40, 0.0, 1e-9)
    sigma, found = 0.01, []
    for _ in range(150):
        noisy = [
            EdgeMatches(
                *(x + rng.normal(size=x.shape, scale=sigma) for x in (edge.p, edge.q)),
                *(np.broadcast_to(sigma**2 * np.eye(3), (len(edge), 3, 3)),) * 2,
            )
            for edge in edges
        ]
        found.append(run(noisy))
    for e, truth in enumerate(T):  # the last one is the closing edge, through the chain
        errors = np.array([perturbation(one.edges[e].T, truth) for one in found])
        covariance = np.mean([one.edges[e].covariance for one in found], axis=0)
        squares = np.einsum("ki,ij,kj->k", errors, np.linalg.inv(covariance), errors)
        # 6 parameters; Cauchy's weights count less information than they use. The mean of 150 has a deviation of 0.25.
        assert squares.mean() == pytest.approx(6 * _counted_over_true(), abs=0.75)


def _counted_over_true():
    """Variance of an M-estimator with the weights w = 1 / (1 + chi^2 / 9) over the inverse of its summed weights."""
    chi2 = np.random.default_rng(0).chisquare(3, 200_000)
    w = 1 / (1 + chi2 / 9)
    slope = w.mean() - 2 / 3 * (w**2 * chi2 / 9).mean()
    return w.mean() * (w**2 * chi2 / 3).mean() / slope**2


@pytest.mark.parametrize("scans", [2, 3, 5])
def test_jobs_and_repetition_change_nothing(scans):
    problems = [noisy_cycle(np.random.default_rng(k), scans, 40, 0.3)[0] for k in range(6)]

    def solve(k):
        return run(problems[k], k)

    one, two = (list(Workers(jobs).map(solve, range(6), "", 6)) for jobs in (1, 2))
    for a, b in zip(one, two, strict=True):
        assert a.hypotheses == b.hypotheses
        for x, y in zip(a.edges, b.edges, strict=True):
            assert x.T.tobytes() == y.T.tobytes() and x.covariance.tobytes() == y.covariance.tobytes()


@pytest.mark.parametrize("scans", [2, 3, 4, 5])
def test_stopping_early_finds_what_all_hypotheses_find(scans):
    for seed in range(4):
        edges, _ = noisy_cycle(np.random.default_rng(seed), scans, 60, 0.3)
        early, all_tried = run(edges, seed), run(edges, seed, adaptive=False)
        assert early.hypotheses < all_tried.hypotheses == 2000
        for a, b in zip(early.edges, all_tried.edges, strict=True):
            np.testing.assert_allclose(a.T, b.T, atol=1e-6)
            assert (a.inliers == b.inliers).all()


@pytest.mark.parametrize("scans", [2, 3, 5])
def test_counting_ends_in_procrustes_as_in_the_paper(scans):
    edges, T = noisy_cycle(np.random.default_rng(3), scans, 80, 0.3)
    found = run(edges, score="count", threshold_m=0.1, adaptive=False, local_optimization=False)
    for edge, matches, truth in zip(found.edges, edges, T, strict=True):
        assert np.linalg.norm(perturbation(edge.T, truth)) < 0.02
        expected = align_points(matches.p[edge.inliers], matches.q[edge.inliers])
        np.testing.assert_allclose(edge.T, se3.pose(expected.R, expected.t), atol=1e-9)


@pytest.mark.parametrize("scans", [2, 3, 4, 5])
def test_degenerate_matches_give_no_estimate_or_a_finite_one(scans):
    edges, _ = noisy_cycle(np.random.default_rng(0), scans, 30, 0.0)
    none = EdgeMatches(*(x[:0] for x in (edges[0].p, edges[0].q, edges[0].cov_p, edges[0].cov_q)))
    assert run([none, *edges[1:]]) is None
    one_point = EdgeMatches(edges[0].p[[0] * 30], edges[0].q[[0] * 30], edges[0].cov_p, edges[0].cov_q)
    assert run([one_point, *edges[1:]]) is None
    line = np.linspace(-1, 1, 30)[:, None] * [1.0, 0.5, 0.2] + [0, 0, 2.0]
    on_line = EdgeMatches(line, line, edges[0].cov_p, edges[0].cov_q)
    found = run([on_line, *edges[1:]])
    assert found is None or all(np.isfinite(edge.T).all() for edge in found.edges)


def test_bad_input_is_named():
    edges, _ = noisy_cycle(np.random.default_rng(0), 3, 20)
    with pytest.raises(MiniloopError, match="no solver for 8 scans"):
        run(edges[:1] * 8)
    with pytest.raises(MiniloopError, match="at least one edge is needed"):
        run([])
    with pytest.raises(MiniloopError, match="no solver for 5 scans with a known vertical"):
        run(edges[:1] * 5, upright=True)
    bad = edges[1].q.copy()
    bad[7, 1] = np.nan
    broken = EdgeMatches(edges[1].p, bad, edges[1].cov_p, edges[1].cov_q)
    with pytest.raises(MiniloopError, match="edge 1: point or covariance 7 is not finite"):
        run([edges[0], broken, edges[2]])
    with pytest.raises(MiniloopError, match="expected p, q"):
        run([EdgeMatches(edges[0].p, edges[0].q[:5], edges[0].cov_p, edges[0].cov_q)])
