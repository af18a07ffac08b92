"""Numbers at the edge: millimetres to kilometres, far off, doubled, in single precision, not numbers at all."""

import warnings

import numpy as np
import pytest
from solver_cases import ALL, PLANAR, distance, poses

from benchmarks.experiments.view_graphs import view_graph
from miniloop_cli.averaging.rotations import average_rotations
from miniloop_cli.averaging.translations import average_translations
from miniloop_cli.bench.problems import random_problems
from miniloop_cli.config import Ransac
from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.ransac.estimate import estimate
from miniloop_cli.ransac.matches import EdgeMatches
from miniloop_cli.refinement.posegraph import refine_pose_graph

SCALES_M = (1e-3, 1.0, 1e3)
FAR_M = np.array([1e4, -1e4, 1e4])
solvers = pytest.mark.parametrize("solver", ALL.values(), ids=ALL.keys())


def problems(solver, count=20):
    rng = np.random.default_rng(5)
    return random_problems(rng, solver.matches, count, upright=solver.name in PLANAR)


@solvers
def test_far_from_the_origin(solver):
    """Coordinates of 10 km leave a solver 12 digits of a metre: the motion of the scans is found to a millimetre."""
    p, q, T = problems(solver)
    shift = se3.pose(np.eye(3), FAR_M)
    back = se3.inverse(shift)
    missed = 0
    for sample_p, sample_q, truth in zip(p, q, T, strict=True):
        found = solver(sample_p + FAR_M, sample_q + FAR_M)
        missed += not len(found) or distance(back @ found @ shift, truth).min() > 1e-3
    assert missed <= 1  # an ill-conditioned sample in 20 may lose what digits it had


@solvers
def test_single_precision_is_taken_for_what_it_says(solver):
    p, q, _ = (np.float32(a) for a in problems(solver))
    T, counts = solver.solve_batch(p, q)
    T64, counts64 = solver.solve_batch(p.astype(float), q.astype(float))
    np.testing.assert_array_equal(counts, counts64)
    np.testing.assert_array_equal(T, T64)


@solvers
def test_doubled_matches_are_refused_or_solved_without_nan(solver):
    p, q, _ = problems(solver)
    p[:, 1], q[:, 1] = p[:, 0], q[:, 0]
    T, counts = solver.solve_batch(p, q)
    assert np.isfinite(T).all()
    for k, count in enumerate(counts):
        R = poses(T[k, :count])[..., :3, :3]
        np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-6)


@solvers
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("side", [0, 1])
def test_a_sample_with_what_is_no_number_has_no_solution(solver, side, value):
    """... and the others of the batch keep theirs."""
    given = problems(solver, 4)[:2]
    expected, counts = solver.solve_batch(*given)
    spoiled = [a.copy() for a in given]
    spoiled[side][1].flat[4] = value
    T, found = solver.solve_batch(*spoiled)
    others = [0, 2, 3]
    assert found[1] == 0
    np.testing.assert_array_equal(found[others], counts[others])
    np.testing.assert_array_equal(T[others], expected[others])


def matches(scale_m=1.0, offset=0.0, count=80, wrong=0.3, dtype=float, seed=0):
    """A pair with known motion: points of about scale_m, noise of a thousandth, a share of wrong matches."""
    rng = np.random.default_rng(seed)
    T = se3.pose(se3.exp_so3(np.array([0.1, -0.3, 0.2])), scale_m * np.array([0.2, -0.1, 0.3]))
    p = scale_m * rng.normal(size=(count, 3))
    q = se3.transform(T, p) + 1e-3 * scale_m * rng.normal(size=(count, 3))
    bad = rng.random(count) < wrong
    q[bad] = scale_m * rng.normal(size=(bad.sum(), 3))
    covariance = np.broadcast_to((1e-3 * scale_m) ** 2 * np.eye(3), (count, 3, 3))
    return EdgeMatches(*(np.asarray(a, dtype) for a in (p + offset, q + offset, covariance, covariance))), T, bad


def settings(scale_m, score):
    return Ransac(score=score, threshold_m=0.02 * scale_m)


def run(edge, scale_m=1.0, score="msac"):
    return estimate([edge], settings(scale_m, score), 16.0, np.random.default_rng(0))


@pytest.mark.parametrize("score", ["msac", "count"])
@pytest.mark.parametrize("scale_m", SCALES_M)
@pytest.mark.parametrize("offset", [0.0, FAR_M], ids=["near", "far"])
def test_the_estimator_at_every_scale(scale_m, offset, score):
    if scale_m < 1 and np.any(offset):
        pytest.skip("a micrometre at 10 km is beyond what a double holds after squares")
    edge, T, bad = matches(scale_m, offset)
    found = run(edge, scale_m, score).edges[0]
    centred = (
        se3.pose(np.eye(3), -np.asarray(offset) * np.ones(3))
        @ found.T
        @ se3.pose(np.eye(3), np.asarray(offset) * np.ones(3))
    )
    assert np.linalg.norm(se3.log_so3(centred[:3, :3] @ T[:3, :3].T)) < 2e-3
    assert np.linalg.norm(centred[:3, 3] - T[:3, 3]) < 2e-3 * scale_m
    assert (found.inliers & ~bad).sum() > 0.9 * (~bad).sum()
    assert np.isfinite(found.information).all()


def test_the_estimator_with_every_match_doubled_or_in_single_precision():
    edge, T, _ = matches()
    twice = EdgeMatches(*(np.concatenate([a, a]) for a in (edge.p, edge.q, edge.cov_p, edge.cov_q)))
    for changed in (twice, matches(dtype=np.float32)[0]):
        found = run(changed).edges[0]
        np.testing.assert_allclose(found.T, T, atol=2e-3)
        assert found.T.dtype == np.float64


def test_one_match_many_times_is_no_pose():
    edge, _, _ = matches()
    same = EdgeMatches(*(np.repeat(a[:1], 50, axis=0) for a in (edge.p, edge.q, edge.cov_p, edge.cov_q)))
    assert run(same) is None


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("which", range(4))
def test_the_estimator_refuses_what_is_no_number(which, value):
    edge, _, _ = matches()
    arrays = [np.array(a) for a in (edge.p, edge.q, edge.cov_p, edge.cov_q)]
    arrays[which][7].flat[0] = value
    with pytest.raises(MiniloopError, match="edge 0: point or covariance 7 is not finite"):
        run(EdgeMatches(*arrays))


@pytest.mark.slow
@pytest.mark.parametrize("scale_m", SCALES_M)
@pytest.mark.parametrize("offset", [0.0, 1e4])
@pytest.mark.parametrize("dtype", [float, np.float32])
def test_averaging_and_pose_graph_at_every_scale(scale_m, offset, dtype):
    """Exact edges between poses of this extent, also in a world whose origin is 10 km off, also in single precision."""
    graph = view_graph("video", 40, 160, 0.0, 0.0, 0.0, np.random.default_rng(0))
    T = graph.T_world_cam.copy()
    T[:, :3, 3] = scale_m * T[:, :3, 3] + offset
    i, j = graph.pairs.T
    T_j_i = (se3.inverse(T[j]) @ T[i]).astype(dtype)
    digits = (1e-6 if dtype is float else 1e-2) * scale_m + 1e-8 * offset
    weights = np.ones(len(graph.pairs))
    weights[::7] = 0.0
    T_j_i[::7, :3, 3] += dtype(scale_m)  # weight zero: whatever it says does not count
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        R = average_rotations(40, graph.pairs, T_j_i[:, :3, :3]).R_world_cam
        t = average_translations(R, graph.pairs, T_j_i[:, :3, 3], weights).t_world_cam
        start = T.copy()
        start[1:, :3, 3] += 1e-2 * scale_m
        information = weights[:, None, None] * np.diag([1e6] * 3 + [1e6 / scale_m**2] * 3)
        refined = refine_pose_graph(start, graph.pairs, T_j_i, information).T_world_cam
    true = se3.inverse(T[0]) @ T
    np.testing.assert_allclose(t, true[:, :3, 3], atol=digits)
    np.testing.assert_allclose((se3.inverse(refined[0]) @ refined)[:, :3, 3], true[:, :3, 3], atol=digits)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_averaging_and_pose_graph_refuse_what_is_no_number(value):
    graph = view_graph("video", 12, 30, 0.0, 0.0, 0.0, np.random.default_rng(0))
    T, pairs, T_j_i, information = graph.T_world_cam, graph.pairs, graph.T_j_i, np.tile(np.eye(6), (30, 1, 1))
    R, t, weights = T[:, :3, :3], T_j_i[:, :3, 3].copy(), np.ones(30)
    turned, moved, start, unsure = T_j_i[:, :3, :3].copy(), T_j_i.copy(), T.copy(), information.copy()
    weights[7] = value
    for array in (turned, moved, t, start, unsure):
        array[7].flat[0] = value
    for refused, what in (
        (lambda: average_rotations(12, pairs, turned), "the rotation of edge 7 is not finite"),
        (lambda: average_rotations(12, pairs, T_j_i[:, :3, :3], weights), "edge 7 has weight"),
        (lambda: average_translations(R, pairs, t), "the translation of edge 7 is not finite"),
        (lambda: average_translations(R, pairs, T_j_i[:, :3, 3], weights), "edge 7 has weight"),
    ):
        with pytest.raises(MiniloopError, match=what):
            refused()
    for given in ((start, pairs, T_j_i, information), (T, pairs, moved, information), (T, pairs, T_j_i, unsure)):
        with pytest.raises(ValueError, match="must be finite"):
            refine_pose_graph(*given)


def test_averaging_and_pose_graph_with_every_edge_doubled():
    graph = view_graph("video", 30, 90, 0.0, 0.2, 0.005, np.random.default_rng(1))
    found = []
    for times in (1, 2):
        pairs, T_j_i = np.tile(graph.pairs, (times, 1)), np.tile(graph.T_j_i, (times, 1, 1))
        R = average_rotations(30, pairs, T_j_i[:, :3, :3]).R_world_cam
        T = se3.pose(R, average_translations(R, pairs, T_j_i[:, :3, 3]).t_world_cam)
        information = np.tile(np.diag([1e6] * 3 + [1e4] * 3), (len(pairs), 1, 1))
        found.append((T, refine_pose_graph(T, pairs, T_j_i, information).T_world_cam))
    for once, twice in zip(*found, strict=True):
        np.testing.assert_allclose(twice, once, atol=1e-3)
