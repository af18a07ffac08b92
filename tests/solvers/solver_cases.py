"""What the tests of the solvers share: the solvers, and how far a set of solutions is from a pose."""

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.solvers import load

SPATIAL = {name: load(name) for name in ("pairwise", "cycle3", "cycle4", "cycle5")}
PLANAR = {name: load(name) for name in ("planar2", "planar3", "planar4")}
ALL = SPATIAL | PLANAR


def poses(T):
    """(..., 3, 4) to (..., 4, 4)."""
    return se3.pose(T[..., :3], T[..., 3])


def distance(solutions, truth):
    """Largest entry by which each of (s, n-1, 4, 4) solutions differs from (n-1, 4, 4)."""
    return np.abs(solutions - truth).max(axis=(1, 2, 3)) if len(solutions) else np.array([np.inf])


def nearest_errors(T, counts, truth):
    """For T (b, s, n-1, 3, 4), counts (b,) and truth (b, n-1, 4, 4): how far the nearest solution is, (b,)."""
    error = np.abs(T - truth[:, None, :, :3]).max(axis=(2, 3, 4))
    error[np.arange(T.shape[1]) >= counts[:, None]] = np.inf
    return error.min(axis=1)


def core_count(solver, p, q, T):
    """Call the compiled mathematics of a solver for one sample, as other compiled code does."""
    return solver.solve(p, q, T) if solver.nearly_real is None else solver.solve(p, q, T, solver.nearly_real)


def require_equal_entries(solver, p, q, truth):
    """One sample at a time, by the compiled mathematics and by the batch, samples (b, k, 3) have the same solutions."""
    T, counts = solver.solve_batch(p, q)
    for i in range(len(p)):
        solutions = solver(p[i], q[i])
        assert solutions.shape == (counts[i], truth.shape[1], 4, 4)
        np.testing.assert_array_equal(solutions, poses(T[i, : counts[i]]))
        core = np.zeros_like(T[i])
        assert core_count(solver, p[i], q[i], core) == counts[i]
        np.testing.assert_allclose(core, T[i], atol=1e-9)
