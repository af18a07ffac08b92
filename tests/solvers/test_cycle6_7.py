"""The 6- and 7-cycle: truth, completeness against many-start Newton, invariances, special and degenerate geometry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from solver_cases import core_count, nearest_errors, poses, require_equal_entries

from miniloop_cli.bench.problems import random_problems
from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.solvers.batch import edges_of, match_residuals
from miniloop_cli.solvers.long_cycles.cycle6 import cycle6
from miniloop_cli.solvers.long_cycles.cycle7 import cycle7

solvers = pytest.mark.parametrize("solver", [cycle6, cycle7], ids=["cycle6", "cycle7"])
FEW = settings(derandomize=True, max_examples=25)


def sample(solver, seed):
    p, q, truth = random_problems(np.random.default_rng(seed), solver.matches, 1)
    return p[0], q[0], truth[0]


def see(solver, rng, points):
    """Matches p, q (b, k, 3) and true poses of random scans that see the given world points (b, k, 3)."""
    scans, count = len(solver.matches), len(points)
    T_scan_world = se3.pose(
        Rotation.random(count * scans, random_state=int(rng.integers(2**31))).as_matrix().reshape(count, scans, 3, 3),
        rng.normal(size=(count, scans, 3)),
    )
    i, j = np.repeat(edges_of(solver.matches), solver.matches, axis=0).T
    p = se3.transform(T_scan_world[:, i], points[:, :, None])[:, :, 0]
    q = se3.transform(T_scan_world[:, j], points[:, :, None])[:, :, 0]
    return p, q, T_scan_world[:, 1:] @ se3.inverse(T_scan_world[:, :-1])


def assert_same_sets(a, b, tolerance):
    """Every pose chain of a (s, n-1, 4, 4) is in b and the other way round."""
    assert len(a) == len(b)
    if len(a):
        apart = np.abs(a[:, None] - b[None]).max(axis=(2, 3, 4))
        assert apart.min(axis=0).max() < tolerance and apart.min(axis=1).max() < tolerance


def every_solution_by_newton(p, q, matches, rng, starts):
    """Solution set (s, n-1, 4, 4) by damped Gauss-Newton on the closing matches from random angles."""
    n = len(matches) - 1
    first, D = np.empty((n, 4, 4)), np.zeros((n, 4, 4))
    for e in range(n):
        a, b = p[2 * e : 2 * e + 2], q[2 * e : 2 * e + 2]
        R = Rotation.align_vectors(np.diff(b, axis=0), np.diff(a, axis=0))[0].as_matrix()
        first[e] = se3.pose(R, b.mean(axis=0) - R @ a.mean(axis=0))
        D[e, :3, :3] = se3.hat((b[1] - b[0]) / np.linalg.norm(b[1] - b[0]))
        D[e, :3, 3] = -D[e, :3, :3] @ b[0]
    P, Q = np.c_[p[2 * n :], np.ones(len(p) - 2 * n)].T, q[2 * n :].T
    angles = rng.uniform(-np.pi, np.pi, (starts, n))
    for _ in range(60):
        s, c = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
        T = (np.eye(4) + s * D + (1 - c) * (D @ D)) @ first
        moved = [np.broadcast_to(P, (starts, *P.shape))]
        for e in range(n):
            moved.append(T[:, e] @ moved[-1])
        error = (moved[-1][:, :3] - Q).reshape(starts, -1)
        J, after = np.empty((starts, error.shape[1], n)), np.eye(4)
        for e in range(n - 1, -1, -1):
            J[:, :, e] = (after @ D[e] @ moved[e + 1])[:, :3].reshape(starts, -1)
            after = after @ T[:, e]
        N = J.transpose(0, 2, 1) @ J
        N[:, range(n), range(n)] += 1e-13 + 1e-3 * np.minimum(1, (error**2).sum(axis=1))[:, None]
        step = np.linalg.solve(N, J.transpose(0, 2, 1) @ error[..., None])[..., 0]
        angles -= step * np.minimum(1, 0.7 / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-9))
    distinct = []
    for solution in T[np.abs(error).max(axis=1) < 1e-10]:
        if not any(np.abs(solution - other).max() < 1e-5 for other in distinct):
            distinct.append(solution)
    return np.array(distinct).reshape(-1, n, 4, 4)


@pytest.mark.slow
@solvers
def test_truth_is_among_at_most_sixteen(solver, rng):
    p, q, truth = random_problems(rng, solver.matches, 5000)
    T, counts = solver.solve_batch(p, q)
    errors = nearest_errors(T, counts, truth)
    assert (errors < 1e-6).mean() >= 0.9995
    assert np.median(errors) < 1e-13
    # Real solutions of a polynomial of degree 16 come in pairs.
    assert (counts % 2 == 0).mean() > 0.999
    assert solver.max_solutions == 16 and counts.min() >= 2 and 10 <= counts.max() <= 16
    assert 4 < counts.mean() < 6


@pytest.mark.slow
@solvers
def test_every_solution_meets_every_match(solver, rng):
    p, q, _ = random_problems(rng, solver.matches, 2000)
    T, counts = solver.solve_batch(p, q)
    used = np.arange(16) < counts[:, None]
    assert not T[~used].any()
    R = T[used][..., :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-13)
    residuals = match_residuals(poses(T), p[:, None], q[:, None], solver.matches)
    assert residuals[used].max() < 1e-11


@solvers
@pytest.mark.parametrize("seed", range(3))
def test_the_whole_set_agrees_with_many_start_newton(solver, seed):
    p, q, _ = sample(solver, [5, seed])
    expected = every_solution_by_newton(p, q, solver.matches, np.random.default_rng(seed), 1200)
    assert_same_sets(solver(p, q), expected, 1e-7)


@solvers
@given(seed=st.integers(0, 10**6))
@FEW
def test_moving_the_frame_of_a_scan_moves_the_poses(solver, seed):
    p, q, _ = sample(solver, seed)
    rng, n = np.random.default_rng(seed), len(solver.matches)
    moves = se3.pose(Rotation.random(n, random_state=seed).as_matrix(), rng.normal(size=(n, 3)))
    i, j = np.repeat(edges_of(solver.matches), solver.matches, axis=0).T
    moved = solver(
        se3.transform(moves[i], p[:, None])[:, 0],
        se3.transform(moves[j], q[:, None])[:, 0],
    )
    assert_same_sets(moved, moves[1:] @ solver(p, q) @ se3.inverse(moves[:-1]), 1e-6)


@solvers
@pytest.mark.parametrize("side", [1e-6, 1e-3, 400.0, 1e6])
def test_any_unit_of_length(solver, side, rng):
    p, q, truth = random_problems(rng, solver.matches, 500, side)
    T, counts = solver.solve_batch(p, q)
    T[..., 3] /= side
    truth[..., :3, 3] /= side
    assert (nearest_errors(T, counts, truth) < 1e-6).mean() > 0.997


@solvers
@given(seed=st.integers(0, 10**6), swaps=st.lists(st.booleans(), min_size=7, max_size=7))
@FEW
def test_order_of_the_matches_of_an_edge_does_not_matter(solver, seed, swaps):
    p, q, _ = sample(solver, seed)
    order, start = [], 0
    for number, swap in zip(solver.matches, swaps, strict=False):
        rows = list(range(start, start + number))
        order += rows[::-1] if swap else rows
        start += number
    assert_same_sets(solver(p[order], q[order]), solver(p, q), 1e-6)


@given(seed=st.integers(0, 10**6), turn=st.integers(1, 5))
@FEW
def test_renumbering_the_scans_of_a_6_cycle_around_the_ring(seed, turn):
    p, q, _ = sample(cycle6, seed)
    # Along the ring scan e -> e+1, the closing edge is run through from scan 6 to scan 1.
    pairs = [(p[2 * e : 2 * e + 2], q[2 * e : 2 * e + 2]) for e in range(5)] + [(q[10:], p[10:])]
    pairs = pairs[turn:] + pairs[:turn]
    pairs[5] = pairs[5][::-1]
    turned = cycle6(*(np.concatenate(side) for side in zip(*pairs, strict=True)))
    chain = cycle6(p, q)
    closing = np.eye(4)
    for e in range(5):
        closing = chain[:, e] @ closing
    ring = np.concatenate([chain, se3.inverse(closing)[:, None]], axis=1)
    assert_same_sets(turned, np.roll(ring, -turn, axis=1)[:, :5], 1e-6)


@solvers
@given(seed=st.integers(0, 10**6))
@FEW
def test_running_through_the_chain_backwards(solver, seed):
    p, q, _ = sample(solver, seed)
    n = len(solver.matches) - 1
    order = np.r_[np.arange(2 * n).reshape(n, 2)[::-1].ravel(), np.arange(2 * n, len(p))]
    backwards = solver(q[order], p[order])
    assert_same_sets(backwards, se3.inverse(solver(p, q))[:, ::-1], 1e-6)


# Pairs of matches (rows) that are one and the same point.
SPECIAL = {
    "two edges share a point": [(1, 2)],
    "each two of the first six edges share a point": [(1, 2), (3, 4), (5, 6), (7, 8), (9, 10)],
    "three axes through one point": [(0, 2), (0, 4)],
    "edges share points in pairs": [(1, 2), (5, 6), (9, 10)],
}


@solvers
@pytest.mark.parametrize("special", SPECIAL)
def test_meeting_axes(solver, special, rng):
    points = rng.normal(size=(1000, sum(solver.matches), 3))
    for source, target in SPECIAL[special]:
        points[:, target] = points[:, source]
    p, q, truth = see(solver, rng, points)
    T, counts = solver.solve_batch(p, q)
    assert (nearest_errors(T, counts, truth) < 1e-6).mean() >= 0.995
    assert (counts % 2 == 0).mean() >= 0.995


def test_ring_of_meeting_axes(rng):
    """Each two neighbouring edges share a point: a six-membered ring of atoms. Every elimination is degenerate."""
    points = rng.normal(size=(500, 12, 3))
    points[:, 0::2] = np.roll(points[:, 1::2], 1, axis=1)
    p, q, truth = see(cycle6, rng, points)
    T, counts = cycle6.solve_batch(p, q)
    assert (nearest_errors(T, counts, truth) < 1e-6).mean() >= 0.97


@solvers
def test_parallel_axes_and_half_turns(solver, rng):
    points = rng.normal(size=(500, sum(solver.matches), 3))
    points[:, 3] = points[:, 2] + points[:, 1] - points[:, 0]
    p, q, truth = see(solver, rng, points)
    T, counts = solver.solve_batch(p, q)
    assert (nearest_errors(T, counts, truth) < 1e-6).mean() >= 0.995
    # No motion at all: every matched pair of frames is equal.
    p = rng.normal(size=(500, sum(solver.matches), 3))
    T, counts = solver.solve_batch(p, p)
    identity = np.broadcast_to(np.eye(4), (500, len(solver.matches) - 1, 4, 4))
    assert (nearest_errors(T, counts, identity) < 1e-6).mean() >= 0.997
    # Every scan is the one before, half a turn about the axis of the edge between them.
    q = p.copy()
    half_turns = np.empty_like(identity)
    for e in range(len(solver.matches) - 1):
        axis = p[:, 2 * e + 1] - p[:, 2 * e]
        R = Rotation.from_rotvec(np.pi * axis / np.linalg.norm(axis, axis=1, keepdims=True)).as_matrix()
        half_turns[:, e] = se3.pose(R, p[:, 2 * e] - np.einsum("bij,bj->bi", R, p[:, 2 * e]))
    closing = half_turns[:, 0]
    for e in range(1, half_turns.shape[1]):
        closing = half_turns[:, e] @ closing
    last = slice(2 * half_turns.shape[1], None)
    q[:, last] = se3.transform(closing, p[:, last])
    T, counts = solver.solve_batch(p, q)
    assert (nearest_errors(T, counts, half_turns) < 1e-6).mean() >= 0.997


def degenerate_points(solver, rng):
    k = sum(solver.matches)
    ends = np.cumsum((0, *solver.matches))[:-1]
    points = rng.normal(size=(100, k, 3))
    for what, source in {"one axis for two edges": (0, 1, 0, 1), "one axis thrice": (0, 1, 0, 1, 0, 1)}.items():
        some = points.copy()
        some[:, : len(source)] = points[:, list(source)]
        yield what, some
    some = points.copy()
    some[:, ends] = points[:, :1]
    yield "all axes through one point", some
    some = points.copy()
    some[:, ends + 1] = some[:, ends] + [0, 0, 1]
    yield "all axes parallel", some
    some = points.copy()
    some[:, 1:8:2] = some[:, 0:8:2] + [0.5, 0, 1]
    yield "four parallel axes", some
    yield "all points on a line", points * [0, 0, 1]


@solvers
def test_movable_chains_give_no_solution(solver, rng):
    for what, points in degenerate_points(solver, rng):
        p, q, _ = see(solver, rng, points)
        T, counts = solver.solve_batch(p, q)
        assert not counts.any(), what
        assert not T.any(), what


@solvers
def test_points_of_one_wall_do_not_give_the_flat_solution(solver, rng):
    """All axes lie in one plane: the chain is singular there. What else closes it is isolated and returned."""
    p, q, truth = see(solver, rng, rng.normal(size=(200, sum(solver.matches), 3)) * [1, 1, 0])
    T, counts = solver.solve_batch(p, q)
    assert (counts == 0).mean() > 0.5
    assert (nearest_errors(T, counts, truth) > 1e-5).all()
    used = np.arange(16) < counts[:, None]
    assert match_residuals(poses(T), p[:, None], q[:, None], solver.matches)[used].max(initial=0) < 1e-9


@solvers
def test_nonsense_gives_no_solution(solver, rng):
    p, q, _ = sample(solver, 1)
    samples = {"zero": (0 * p, 0 * q), "not a number": (np.full_like(p, np.nan), q), "infinite": (p, q + np.inf)}
    for i in range(len(p)):
        for value in (np.nan, np.inf, -np.inf):
            bad = p.copy()
            bad[i, i % 3] = value
            samples[f"{value} in {i}"] = bad, q
    for i in range(0, 12, 2):
        a, b = p.copy(), q.copy()
        a[i + 1], b[i + 1] = a[i], b[i]
        samples[f"coincident matches {i}"] = a, b
        samples[f"coincident in one scan {i}"] = p, b
    if solver is cycle7:
        a, b = p.copy(), q.copy()
        a[14], b[14] = 0.3 * a[12] + 0.7 * a[13], 0.3 * b[12] + 0.7 * b[13]
        samples["closing matches on a line"] = a, b
    for what, (a, b) in samples.items():
        T = np.zeros((16, len(solver.matches) - 1, 3, 4))
        assert core_count(solver, a, b, T) == 0, what
        assert not T.any(), what


@solvers
def test_unrelated_points_and_noise_give_finite_proper_poses(solver, rng):
    p, q = rng.normal(size=(2, 1000, sum(solver.matches), 3))
    for nearly_real in (0.0, 0.2):
        T, counts = solver.solve_batch(p, q, nearly_real)
        assert np.isfinite(T).all() and counts.max() <= 16
        R = T[np.arange(16) < counts[:, None]][..., :3]
        np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)


@solvers
def test_noise_moves_solutions_little_and_nearly_real_pairs_are_kept(solver, rng):
    p, q, truth = random_problems(rng, solver.matches, 2000)
    T, counts = solver.solve_batch(p, q + rng.normal(scale=1e-9, size=q.shape))
    assert np.median(nearest_errors(T, counts, truth)) < 1e-7
    noisy = q + rng.normal(scale=0.01, size=q.shape)
    T, counts = solver.solve_batch(p, noisy)
    exact = nearest_errors(T, counts, truth)
    T, counts = solver.solve_batch(p, noisy, nearly_real=0.3)
    tolerant = nearest_errors(T, counts, truth)
    assert (tolerant < 0.3).sum() > (exact < 0.3).sum()
    assert np.quantile(tolerant, 0.75) <= np.quantile(exact, 0.75)


@solvers
def test_entries_agree(solver, rng):
    p, q, truth = random_problems(rng, solver.matches, 20)
    require_equal_entries(solver, p, q, truth)
    for i in range(len(p)):
        assert solver(p[i], q[i], best=True).shape == (1, truth.shape[1], 4, 4)


@solvers
def test_wrong_shapes_are_told(solver):
    p, q, _ = sample(solver, 1)
    with pytest.raises(MiniloopError, match=str(len(p))):
        solver(p[:-1], q[:-1])
    with pytest.raises(MiniloopError, match="samples"):
        solver.solve_batch(p, q)
    assert solver.name == f"cycle{len(solver.matches)}"
