import numpy as np
import pytest
from refinement_scenes import errors, graph, perturbed, tangent
from scipy.optimize import least_squares

from miniloop_cli.geometry.se3 import exp_so3, inverse, pose
from miniloop_cli.refinement.block_system import SMALL
from miniloop_cli.refinement.edge_terms import evaluate_edges, make_edges
from miniloop_cli.refinement.posegraph import PoseGraphSettings, refine_pose_graph
from miniloop_cli.scene.view_graph import GraphError

TIGHT = PoseGraphSettings(relative_tolerance=1e-14, max_iterations=300)


def rng_of(seed):
    return np.random.default_rng(seed)


def cost(T, pairs, T_j_i, information, kernel, scale):
    edges = make_edges(len(T), pairs, T_j_i, information, kernel, scale)
    scratch = np.empty((2, len(pairs)))
    return evaluate_edges(edges, np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3]), *scratch)


def test_residual_is_the_noise_that_was_put_in():
    rng = rng_of(0)
    T, pairs, exact, information, _ = graph(rng, noise=False)
    xi = 0.5 * rng.standard_normal((len(pairs), 6))
    measured = inverse(pose(exp_so3(xi[:, :3]), xi[:, 3:])) @ exact  # true = Exp(xi) measured
    edges = make_edges(len(T), pairs, measured, information, "none", 1.0)
    chi2, weights = np.empty(len(pairs)), np.empty(len(pairs))
    evaluate_edges(edges, np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3]), chi2, weights)
    np.testing.assert_allclose(chi2, np.einsum("mi,mij,mj->m", xi, information, xi), rtol=1e-9)
    assert (weights == 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["none", "cauchy", "geman-mcclure"])
def test_exact_edges_recover_the_truth(kernel):
    rng = rng_of(1)
    T, pairs, measured, information, _ = graph(rng, noise=False)
    start = perturbed(T, rng, 3.0, 0.05)
    start[4] = T[4]
    found = refine_pose_graph(
        start, pairs, measured, 1e-4 * information, PoseGraphSettings(kernel=kernel, fixed_frame=4, max_iterations=200)
    )
    np.testing.assert_allclose(found.T_world_cam, T, atol=1e-6)
    assert found.descent.converged
    np.testing.assert_array_equal(found.T_world_cam[4, :3, :3] @ T[4, :3, :3].T > 0.999999, np.eye(3) > 0)


@pytest.mark.parametrize("kernel", ["none", "cauchy", "geman-mcclure"])
def test_same_minimum_as_scipy(kernel):
    rng = rng_of(2)
    T, pairs, measured, information, _ = graph(rng, n=6, edges=14, wrong=0.2)
    settings = PoseGraphSettings(kernel=kernel, scale=4.0, relative_tolerance=1e-15, max_iterations=500)
    found = refine_pose_graph(perturbed(T, rng, 1.0, 0.02), pairs, measured, information, settings)
    whiten = np.linalg.cholesky(information).transpose(0, 2, 1)

    def moved(x):
        x = np.concatenate([np.zeros(6), x]).reshape(-1, 6)
        return found.T_world_cam @ pose(exp_so3(x[:, :3]), x[:, 3:])

    def residuals(x):
        P = moved(x)
        r = np.einsum("mij,mj->mi", whiten, tangent(inverse(P[pairs[:, 1]]) @ P[pairs[:, 0]] @ inverse(measured)))
        s = (r**2).sum(axis=1, keepdims=True)
        rho = {"none": s, "cauchy": 16 * np.log1p(s / 16), "geman-mcclure": s * 16 / (16 + s)}[kernel]
        return (r * np.sqrt(rho / np.maximum(s, 1e-30))).ravel()

    assert 0.5 * (residuals(np.zeros(30)) ** 2).sum() == pytest.approx(found.descent.cost_after, rel=1e-9)
    oracle = least_squares(residuals, np.zeros(30), xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac")
    assert found.descent.cost_after <= oracle.cost * (1 + 1e-7)
    assert np.abs(oracle.x).max() < 1e-4
    assert cost(found.T_world_cam, pairs, measured, information, kernel, 4.0) == pytest.approx(
        found.descent.cost_after, rel=1e-9
    )


def test_poses_and_covariances_agree_with_gtsam():
    gtsam = pytest.importorskip("gtsam")
    rng = rng_of(3)
    T, pairs, measured, information, _ = graph(rng, n=25, edges=80, sigma_rad=1e-3, sigma_m=2e-3)
    start = perturbed(T, rng, 0.2, 0.005)
    settings = PoseGraphSettings(kernel="none", relative_tolerance=1e-13)
    found = refine_pose_graph(start, pairs, measured, information, settings)

    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(start[0]), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    for f, P in enumerate(start):
        values.insert(f, gtsam.Pose3(P))
    for (i, j), M, L in zip(pairs.tolist(), measured, information, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(L)
        factors.add(gtsam.BetweenFactorPose3(i, j, gtsam.Pose3(inverse(M)), noise))
    oracle = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    theirs = np.stack([oracle.atPose3(f).matrix() for f in range(len(T))])
    np.testing.assert_allclose(found.T_world_cam, theirs, atol=2e-5)  # our translation residual differs in second order
    marginals = gtsam.Marginals(factors, oracle)
    scale = max(found.variance_factor, 1.0)
    for f in range(1, len(T)):
        expected = marginals.marginalCovariance(f)
        np.testing.assert_allclose(
            found.covariance[f] / scale,
            expected,
            atol=0.02 * np.sqrt(np.outer(expected.diagonal(), expected.diagonal())).max(),
        )
        np.testing.assert_allclose(found.covariance[f].diagonal() / scale, expected.diagonal(), rtol=0.05)


def test_wrong_edges_do_no_harm():
    rng = rng_of(4)
    T, pairs, measured, information, lies = graph(rng, n=40, edges=250, wrong=0.15)
    assert lies.sum() > 20
    start = perturbed(T, rng, 1.0, 0.02)
    robust = refine_pose_graph(start, pairs, measured, information)
    plain = refine_pose_graph(start, pairs, measured, information, PoseGraphSettings(kernel="none"))
    rms = [np.sqrt((errors(T, r.T_world_cam, 0)[:, 3:] ** 2).mean()) for r in (robust, plain)]
    assert rms[0] < 0.02 < 0.1 < rms[1]
    assert robust.weights[lies].max() < 0.1
    assert np.median(robust.weights[~lies]) > 0.9
    assert robust.variance_factor < 1.6


def test_gauge_does_not_matter():
    rng = rng_of(5)
    T, pairs, measured, information, _ = graph(rng)
    start = perturbed(T, rng, 1.0, 0.02)
    first = refine_pose_graph(start, pairs, measured, information, TIGHT)
    G = pose(exp_so3(np.array([0.4, -1.2, 2.0])), np.array([1e4, -1e4, 500.0]))
    moved = refine_pose_graph(G @ start, pairs, measured, information, TIGHT)
    np.testing.assert_allclose(moved.T_world_cam, G @ first.T_world_cam, atol=1e-6)
    np.testing.assert_allclose(moved.covariance, first.covariance, rtol=1e-4, atol=1e-12)


def test_direction_of_edges_does_not_matter():
    rng = rng_of(5)
    T, pairs, measured, information, _ = graph(rng, sigma_rad=1e-3, sigma_m=2e-3)
    start = perturbed(T, rng, 0.1, 0.002)
    first = refine_pose_graph(start, pairs, measured, information, TIGHT)
    # The same edges told backwards: T_i_j, its noise seen from frame i.
    ad = np.zeros((len(pairs), 6, 6))
    R, t = measured[:, :3, :3], measured[:, :3, 3]
    ad[:, :3, :3] = ad[:, 3:, 3:] = R
    ad[:, 3:, :3] = np.cross(t[:, None], R.transpose(0, 2, 1)).transpose(0, 2, 1)
    backwards = ad.transpose(0, 2, 1) @ information @ ad
    again = refine_pose_graph(start, pairs[:, ::-1], inverse(measured), backwards, TIGHT)
    # Decoupled translation residuals differ in second order of the noise.
    np.testing.assert_allclose(again.T_world_cam, first.T_world_cam, atol=2e-5)
    np.testing.assert_allclose(again.covariance, first.covariance, rtol=0.1, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("kernel", "scale"), [("none", 1.0), ("cauchy", 3.0), ("cauchy", 10.0)])
def test_covariances_are_those_of_the_errors(kernel, scale):
    inside, squares = [], []
    for seed in range(25):
        rng = rng_of([6, seed])
        T, pairs, measured, information, _ = graph(rng, n=20, edges=60)
        settings = PoseGraphSettings(kernel=kernel, scale=scale)
        found = refine_pose_graph(perturbed(T, rng, 0.5, 0.01), pairs, measured, information, settings)
        xi, C = errors(T, found.T_world_cam, 0)[1:], found.covariance[1:]
        inside.append(np.abs(xi) < 2 * np.sqrt(np.einsum("nii->ni", C)))
        squares.append(np.einsum("ni,nij,nj->n", xi, np.linalg.inv(C), xi) / 6)
    assert 0.92 < np.mean(inside) < 0.98
    assert 0.75 < np.mean(squares) < 1.25


def test_information_that_promises_too_much_is_found_out():
    rng = rng_of(7)
    T, pairs, measured, information, _ = graph(rng, n=40, edges=300)
    honest = refine_pose_graph(T, pairs, measured, information)
    boast = refine_pose_graph(T, pairs, measured, 25 * information, PoseGraphSettings(scale=50.0))
    assert honest.variance_factor == pytest.approx(1.0, abs=0.2)
    assert boast.variance_factor == pytest.approx(25, rel=0.2)
    assert np.trace(boast.covariance[7]) == pytest.approx(np.trace(honest.covariance[7]), rel=0.3)


def test_groups_that_nothing_connects():
    rng = rng_of(8)
    T, pairs, measured, information, _ = graph(rng, n=12, edges=30)
    apart = (pairs[:, 0] < 6) == (pairs[:, 1] < 6)
    apart &= (pairs != 11).all(axis=1)  # frame 11 has no edge at all
    start = perturbed(T, rng, 1.0, 0.02)
    settings = PoseGraphSettings(fixed_frame=2)
    found = refine_pose_graph(start, pairs[apart], measured[apart], information[apart], settings)
    for kept in (2, 6, 11):
        np.testing.assert_allclose(found.T_world_cam[kept], start[kept], atol=1e-12)
    assert np.isfinite(found.covariance[:6]).all()
    assert np.isinf(np.einsum("nii->ni", found.covariance[6:])).all()
    assert not found.covariance[2].any()


def test_no_edges_and_one_frame():
    found = refine_pose_graph(np.eye(4)[None], np.zeros((0, 2)), np.zeros((0, 4, 4)), np.zeros((0, 6, 6)))
    np.testing.assert_array_equal(found.T_world_cam, np.eye(4)[None])
    assert found.descent.converged
    assert found.variance_factor == 1.0


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_units_of_length_do_not_matter(scale):
    rng = rng_of(9)
    T, pairs, measured, information, _ = graph(rng, n=15, edges=50)
    start = perturbed(T, rng, 1.0, 0.02)
    plain = refine_pose_graph(start, pairs, measured, information, TIGHT)
    S = np.diag([1, 1, 1] + [1 / scale] * 3)
    start[:, :3, 3] *= scale
    measured[:, :3, 3] *= scale
    scaled = refine_pose_graph(start, pairs, measured, S @ information @ S, TIGHT)
    np.testing.assert_allclose(scaled.T_world_cam[:, :3, :3], plain.T_world_cam[:, :3, :3], atol=1e-7)
    np.testing.assert_allclose(scaled.T_world_cam[:, :3, 3] / scale, plain.T_world_cam[:, :3, 3], atol=1e-6)


def test_half_turns_are_finite():
    rng = rng_of(10)
    T, pairs, measured, information, _ = graph(rng, n=8, edges=20)
    measured[3, :3, :3] = measured[3, :3, :3] @ np.diag([1.0, -1.0, -1.0])
    found = refine_pose_graph(T, pairs, measured, information)
    assert np.isfinite(found.T_world_cam).all()
    assert found.weights[3] < 0.01
    assert np.abs(errors(T, found.T_world_cam, 0)).max() < 0.1


def test_pieces_do_not_disturb_each_other():
    """One piece is solved densely; as many as these together are not."""
    rng = rng_of(11)
    T, pairs, measured, information, _ = graph(rng, n=60, edges=100)
    start = perturbed(T, rng, 1.0, 0.02)
    alone = refine_pose_graph(start, pairs, measured, information, TIGHT)
    pieces = SMALL // 60 + 1
    edges = (np.concatenate([a] * pieces) for a in (measured, information))
    all_pairs = np.concatenate([pairs + 60 * k for k in range(pieces)])
    all_of_them = refine_pose_graph(np.tile(start, (pieces, 1, 1)), all_pairs, *edges, TIGHT)
    for one in np.split(all_of_them.T_world_cam, pieces):
        np.testing.assert_allclose(one, alone.T_world_cam, atol=1e-6)
    np.testing.assert_allclose(all_of_them.covariance[:60], alone.covariance, rtol=1e-4, atol=1e-10)


@pytest.mark.parametrize(
    "change",
    [
        {"T_world_cam": np.full((3, 4, 4), np.nan)},
        {"T_world_cam": np.eye(4)},
        {"T_j_i": np.full((1, 4, 4), np.nan)},
        {"information": np.full((1, 6, 6), np.nan)},
        {"information": -np.eye(6)[None]},
        {"information": np.zeros((2, 6, 6))},
        {"pairs": [(0, 3)]},
        {"pairs": [(1, 1)]},
        {"settings": PoseGraphSettings(fixed_frame=3)},
    ],
)
def test_refuses_what_is_no_pose_graph(change):
    given = {
        "T_world_cam": np.tile(np.eye(4), (3, 1, 1)),
        "pairs": [(0, 1)],
        "T_j_i": np.eye(4)[None],
        "information": np.eye(6)[None],
    }
    with pytest.raises((ValueError, GraphError)):
        refine_pose_graph(**(given | change))
