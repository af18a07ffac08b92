"""What must not depend on the frames, the unit, the order of matches or the direction of the cycle."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from solver_cases import ALL, PLANAR, distance, poses

from miniloop_cli.bench.problems import random_problems, random_rotations
from miniloop_cli.geometry import se3
from miniloop_cli.solvers._kernels.cycle_rotation import poses_from_rotated, rotated_matches
from miniloop_cli.solvers.batch import edges_of

solvers = pytest.mark.parametrize("solver", ALL.values(), ids=ALL.keys())
seeds = st.integers(0, 10**6)
EXAMPLES = settings(derandomize=True, max_examples=40)
# Random problems may be ill-conditioned; a wrong formula is off by far more.
TOLERANCE = 1e-5


def problem(solver, seed):
    rng = np.random.default_rng(seed)
    p, q, T = random_problems(rng, solver.matches, 1, upright=solver.name in PLANAR)
    return rng, p[0], q[0], T[0]


def solutions(solver, p, q):
    """All solutions that exact data determines; of the 5-cycle's only the best meets all equations."""
    if solver.name == "cycle4":
        # The real part of a complex pair is a stopgap for noise and depends on the frames.
        T, counts = solver.solve_batch(p[None], q[None], nearly_real=0.0)
        return poses(T[0, : counts[0]])
    return solver(p, q, best=solver.name == "cycle5")


def assert_same(found, expected):
    assert len(found) == len(expected) > 0
    assert all(distance(found, pose).min() < TOLERANCE for pose in expected)
    assert all(distance(expected, pose).min() < TOLERANCE for pose in found)


def moved(solver, points, motions, end):
    """Matches of every edge moved by the motion of the scan at this end (0: p, 1: q)."""
    scans = np.repeat([edge[end] for edge in edges_of(solver.matches)], solver.matches)
    return np.einsum("kij,kj->ki", motions[scans, :3, :3], points) + motions[scans, :3, 3]


@solvers
@given(seed=seeds)
@EXAMPLES
def test_gauge(solver, seed):
    """Moving every scan by a motion of its own moves the solutions with it."""
    rng, p, q, _ = problem(solver, seed)
    scans = max(len(solver.matches), 2)
    X = se3.pose(random_rotations(rng, (scans,), solver.name in PLANAR), rng.normal(size=(scans, 3)))
    expected = X[1:] @ solutions(solver, p, q) @ se3.inverse(X[:-1])
    assert_same(solutions(solver, moved(solver, p, X, 0), moved(solver, q, X, 1)), expected)


@solvers
@given(seed=seeds, scale=st.floats(1e-3, 1e3))
@EXAMPLES
def test_scale(solver, seed, scale):
    _, p, q, _ = problem(solver, seed)
    found = solutions(solver, scale * p, scale * q)
    found[..., :3, 3] /= scale
    assert_same(found, solutions(solver, p, q))


@solvers
@given(seed=seeds)
@EXAMPLES
def test_order_of_matches_within_an_edge(solver, seed):
    rng, p, q, _ = problem(solver, seed)
    edges = np.split(np.arange(len(p)), np.cumsum(solver.matches)[:-1])
    order = np.concatenate([rng.permutation(edge) for edge in edges])
    assert_same(solutions(solver, p[order], q[order]), solutions(solver, p, q))


@solvers
@given(seed=seeds)
@EXAMPLES
def test_direction_of_the_cycle(solver, seed):
    """Read from the last scan to the first, the cycle has the inverse poses in the opposite order."""
    _, p, q, _ = problem(solver, seed)
    edges = np.split(np.arange(len(p)), np.cumsum(solver.matches)[:-1])
    order = np.concatenate([*edges[:-1][::-1], edges[-1]])
    expected = se3.inverse(solutions(solver, p, q))[:, ::-1]
    assert_same(solutions(solver, q[order], p[order]), expected)


@given(seed=seeds)
@EXAMPLES
def test_any_edge_of_a_5_cycle_may_close_it(seed):
    """Two matches an edge all around: scans may be counted from anywhere."""
    solver = ALL["cycle5"]
    _, p, q, truth = problem(solver, seed)
    # Start at scan 2: chain 2-3, 3-4, 4-5, 5-1, closed by 2-1; edges 5-1 and 2-1 are read backwards.
    order = np.array([2, 3, 4, 5, 6, 7, 8, 9, 0, 1])
    backwards = np.array([False] * 6 + [True] * 4)[:, None]
    turned_p, turned_q = np.where(backwards, q[order], p[order]), np.where(backwards, p[order], q[order])
    # The closing pair runs from scan 2 (new first) to scan 1 (new last).
    found = solutions(solver, turned_p, turned_q)
    T_1_5 = se3.inverse(truth[3] @ truth[2] @ truth[1] @ truth[0])
    assert_same(found, np.stack([truth[1], truth[2], truth[3], T_1_5])[None])


@solvers
@given(seed=seeds)
@EXAMPLES
def test_identical_scans_have_the_identity(solver, seed):
    p = np.random.default_rng(seed).normal(size=(sum(solver.matches), 3))
    found = solver(p, p)
    assert distance(found, np.eye(4)).min() < TOLERANCE


@pytest.mark.parametrize("start", [1, 2, 3, 4])
def test_ring_rotated_matches_another_scan_and_back(start, rng):
    solver = ALL["cycle5"]
    p, q, truth = (a[0] for a in random_problems(rng, solver.matches, 1))
    new_p, new_q, T = np.empty((10, 3)), np.empty((10, 3)), np.zeros((4, 3, 4))
    rotated_matches(start, p, q, new_p, new_q)
    new_T = solver(new_p, new_q, best=True)[0]
    poses_from_rotated(start, np.ascontiguousarray(new_T[None, :, :3]), T[None], 0)
    np.testing.assert_allclose(T, truth[:, :3], atol=1e-9)
