"""Every solver by the one calling convention: the truth is found, bounds hold, degenerate samples give nothing."""

import subprocess
import sys

import numpy as np
import pytest
from solver_cases import ALL, PLANAR, core_count, nearest_errors, poses, require_equal_entries

from miniloop_cli.bench.problems import random_problems
from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.solvers import SOLVERS, load, solver_name
from miniloop_cli.solvers.batch import edges_of, match_residuals

solvers = pytest.mark.parametrize("solver", ALL.values(), ids=ALL.keys())
BOUNDS = {"pairwise": 1, "cycle3": 2, "cycle4": 4, "cycle5": 8, "planar2": 1, "planar3": 2, "planar4": 2}


def problems(solver, rng, count, side=1.0):
    return random_problems(rng, solver.matches, count, side, upright=solver.name in PLANAR)


@pytest.mark.slow
@solvers
def test_truth_is_among_the_solutions(solver, rng):
    p, q, truth = problems(solver, rng, 20000)
    T, counts = solver.solve_batch(p, q)
    errors = nearest_errors(T, counts, truth)
    assert (errors < 1e-6).mean() >= 0.9995
    assert np.median(errors) < 1e-13


@solvers
def test_bounds_and_proper_poses(solver, rng):
    p, q, _ = problems(solver, rng, 3000)
    q += rng.normal(scale=0.02, size=q.shape)
    T, counts = solver.solve_batch(p, q)
    assert BOUNDS[solver.name] == solver.max_solutions
    assert counts.max() <= solver.max_solutions and counts.min() >= 0
    assert np.isfinite(T).all()
    used = np.arange(solver.max_solutions) < counts[:, None]
    assert not T[~used].any()
    R = T[used][..., :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    assert (np.linalg.det(R) > 0).all()


@solvers
def test_every_exact_solution_meets_every_match(solver, rng):
    p, q, _ = problems(solver, rng, 2000)
    T, counts = solver.solve_batch(p, q, nearly_real=0.0)
    # The 5-cycle has one equation more than unknowns: only its best solution meets them all.
    slots = 1 if solver.name == "cycle5" else solver.max_solutions
    worst = [match_residuals(poses(T[:, s]), p, q, solver.matches).max(axis=1)[counts > s] for s in range(slots)]
    residuals = np.concatenate(worst)
    assert np.quantile(residuals, 0.999) < 1e-6
    assert np.median(residuals) < 1e-13


@solvers
def test_single_entry_core_and_batch_agree(solver, rng):
    p, q, truth = problems(solver, rng, 20)
    require_equal_entries(solver, p, q, truth)


@solvers
def test_best_keeps_one_solution(solver, rng):
    p, q, _ = problems(solver, rng, 50)
    for i in range(len(p)):
        best = solver(p[i], q[i], best=True)
        assert len(best) == 1
        assert match_residuals(best[0], p[i], q[i], solver.matches).max() < 1e-6


def test_redundant_match_singles_out_the_truth_of_a_5_cycle(rng):
    solver = ALL["cycle5"]
    p, q, truth = problems(solver, rng, 5000)
    T, counts = solver.solve_batch(p, q)
    first = np.abs(T[:, 0] - truth[:, :, :3]).max(axis=(1, 2, 3))
    assert (first < 1e-6).mean() > 0.999
    # Sorted: the closing residual grows with the slot.
    closing = [match_residuals(poses(T[:, s]), p, q, solver.matches)[:, -2:] for s in range(4)]
    norms = np.linalg.norm(closing, axis=-1)
    for s in range(3):
        both = counts > s + 1
        assert (norms[s][both] <= norms[s + 1][both] + 1e-9).all()


@solvers
@pytest.mark.parametrize("side", [1e-6, 1e-3, 400.0, 1e6])
def test_any_unit_of_length(solver, side, rng):
    p, q, truth = problems(solver, rng, 500, side)
    T, counts = solver.solve_batch(p, q)
    T[..., 3] /= side
    truth[..., :3, 3] /= side
    assert (nearest_errors(T, counts, truth) < 1e-6).mean() > 0.99


@solvers
def test_small_noise_moves_solutions_little(solver, rng):
    p, q, truth = problems(solver, rng, 2000)
    q = q + rng.normal(scale=1e-9, size=q.shape)
    T, counts = solver.solve_batch(p, q)
    errors = nearest_errors(T, counts, truth)
    assert np.median(errors) < 1e-7
    assert (errors < 1e-4).mean() > 0.99


def degenerate_samples(solver, rng):
    k = sum(solver.matches)
    p, q, _ = (a[0] for a in problems(solver, rng, 1))
    x = rng.normal(size=(k, 3))
    vertical = x * [0, 0, 1]
    yield "all zero", np.zeros((k, 3)), np.zeros((k, 3))
    yield "one point", np.tile(x[0], (k, 1)), np.tile(x[1], (k, 1))
    yield "one point in scan e only", np.tile(x[0], (k, 1)), q
    yield "not a number", np.full((k, 3), np.nan), q
    yield "infinite", p, np.full((k, 3), np.inf)
    yield "on a vertical line", vertical, vertical
    for i in range(k):
        for value in (np.nan, np.inf, -np.inf):
            for axis in range(3):
                bad = p.copy()
                bad[i, axis] = value
                yield f"{value} at {i}, {axis}", bad, q
                yield f"{value} at {i}, {axis} of q", p, np.where(bad == p, q, bad)


@solvers
def test_degenerate_samples_give_no_solution(solver, rng):
    for what, p, q in degenerate_samples(solver, rng):
        T = np.zeros((solver.max_solutions, max(len(solver.matches), 2) - 1, 3, 4))
        assert core_count(solver, np.ascontiguousarray(p), np.ascontiguousarray(q), T) == 0, what
        assert not T.any(), what


@pytest.mark.parametrize("name", ["pairwise", "cycle3", "cycle4", "cycle5"])
def test_degenerate_geometry_in_space(name, rng):
    solver = ALL[name]
    k = sum(solver.matches)
    p, q, _ = (a[0] for a in problems(solver, rng, 1))
    line = np.outer(rng.normal(size=k), rng.normal(size=3)) + rng.normal(size=3)
    samples = {"collinear": (line, line)}
    twice, twice_q = p.copy(), q.copy()
    twice[1], twice_q[1] = p[0], q[0]
    if name == "pairwise":
        on_axis = 0.3 * p[0] + 0.7 * p[1], 0.3 * q[0] + 0.7 * q[1]
    else:
        # The closing match on the first axis: the first turn cannot be seen.
        on_axis = 0.3 * p[0] + 0.7 * p[1], q[-1]
    samples["coincident matches"] = (twice, twice_q)
    a, b = p.copy(), q.copy()
    a[-1], b[-1] = on_axis
    if name == "cycle5":
        a[-2] = -0.5 * p[0] + 1.5 * p[1]
    samples["closing match on an axis"] = (a, b)
    for what, (a, b) in samples.items():
        assert len(solver(a, b)) == 0, what


@pytest.mark.parametrize(
    ("name", "scans"),
    [("cycle3", [1]), ("cycle4", [1]), ("cycle4", [2]), *(("cycle5", s) for s in ([1], [2], [3], [1, 2], [2, 3]))],
)
def test_axes_that_meet(name, scans, rng):
    """Both edges of a scan match the same point of it, so that their axes meet there: common with real features."""
    solver = ALL[name]
    p, q, truth = problems(solver, rng, 2000)
    for scan in scans:
        p[:, 2 * scan] = q[:, 2 * scan - 1]
        q[:, 2 * scan] = se3.transform(truth[:, scan], p[:, None, 2 * scan])[:, 0]
    T, counts = solver.solve_batch(p, q)
    assert (nearest_errors(T, counts, truth) < 1e-6).mean() > 0.999
    if name == "cycle3":
        # The redundancy is gone: two mirrored solutions, both exact.
        assert (counts == 2).all()
        assert np.quantile(match_residuals(poses(T), p[:, None], q[:, None], solver.matches), 0.999) < 1e-9
    else:
        assert counts.max() <= solver.max_solutions


def test_random_3_cycles_have_one_solution(rng):
    p, q, _ = problems(ALL["cycle3"], rng, 20000)
    assert (ALL["cycle3"].solve_batch(p, q)[1] == 1).all()


def test_points_of_one_plane_do_not_determine_a_cycle(rng):
    """Axes within one wall all meet: scans can be bent about them at no cost to first order."""
    for name in ("cycle4", "cycle5"):
        p = rng.normal(size=(sum(ALL[name].matches), 3)) * [1, 1, 0] + [0, 0, 2.0]
        assert len(ALL[name](p, p)) == 0
    # The 3-cycle is a double root: exact data gives it, to half the digits.
    p = rng.normal(size=(5, 3)) * [1, 1, 0] + [0, 0, 2.0]
    found = ALL["cycle3"](p, p)
    assert np.abs(found - np.eye(4)).max() < 1e-6


@solvers
def test_wrong_shapes_are_told(solver, rng):
    p, q, _ = (a[0] for a in problems(solver, rng, 1))
    with pytest.raises(MiniloopError, match=str(len(p))):
        solver(p[:-1], q[:-1])
    with pytest.raises(MiniloopError, match="samples"):
        solver.solve_batch(p, q)


def test_edges_of_a_cycle():
    assert edges_of((3,)) == [(0, 1)]
    assert edges_of((2, 2, 1)) == [(0, 1), (1, 2), (0, 2)]
    assert edges_of((2, 2, 2, 2, 2)) == [(0, 1), (1, 2), (2, 3), (3, 4), (0, 4)]


def test_residuals_of_the_truth_are_zero_and_of_a_shifted_edge_known(rng):
    p, q, truth = (a[0] for a in random_problems(rng, (2, 2, 1), 1))
    np.testing.assert_allclose(match_residuals(truth, p, q, (2, 2, 1)), 0, atol=1e-14)
    shifted = truth.copy()
    shifted[1, 2, 3] += 0.25
    np.testing.assert_allclose(match_residuals(shifted, p, q, (2, 2, 1)), [0, 0, 0.25, 0.25, 0.25], atol=1e-14)


def test_solvers_are_found_by_name_and_by_number_of_scans():
    assert [solver_name(scans) for scans in range(2, 8)] == ["pairwise", *(f"cycle{n}" for n in range(3, 8))]
    assert [solver_name(scans, upright=True) for scans in (2, 3, 4)] == ["planar2", "planar3", "planar4"]
    for name, listed in SOLVERS.items():
        solver = load(name)
        assert solver.name == name and max(len(solver.matches), 2) == listed.scans
    with pytest.raises(MiniloopError, match="cycle8"):
        load("cycle8")
    with pytest.raises(MiniloopError, match="5 scans with a known vertical"):
        solver_name(5, upright=True)


def test_a_solver_is_imported_when_it_is_asked_for():
    code = (
        "import sys; from miniloop_cli.solvers import load; load('cycle3')\n"
        "print(*sorted(name for name in sys.modules if name.startswith('miniloop_cli.solvers.') and '._' not in name))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["miniloop_cli.solvers.batch", "miniloop_cli.solvers.cycle3"]
