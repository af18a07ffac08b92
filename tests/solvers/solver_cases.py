"""What the tests of the solvers share: the modules, and how far a set of solutions is from a pose."""

from types import ModuleType

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.solvers import cycle3, cycle4, cycle5, pairwise, planar2, planar3, planar4

SPATIAL = {"pairwise": pairwise, "cycle3": cycle3, "cycle4": cycle4, "cycle5": cycle5}
PLANAR = {"planar2": planar2, "planar3": planar3, "planar4": planar4}
ALL = SPATIAL | PLANAR


def name_of(module: ModuleType) -> str:
    return module.__name__.rsplit(".", 1)[-1]


def single(module: ModuleType):
    """The Python entry of a solver for one sample."""
    return getattr(module, name_of(module))


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
