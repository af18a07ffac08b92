"""The minimal solvers, by name: for a pair, for cycles of 3 to 7 scans, and for 2 to 4 scans with a known vertical.

    from miniloop_cli.solvers import load

    poses = load("cycle4")(p, q)

`SOLVERS` lists them. A solver's module is imported, and so compiled, when the solver is first loaded.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

from miniloop_cli.errors import MiniloopError

if TYPE_CHECKING:
    from miniloop_cli.solvers.batch import MinimalSolver

__all__ = ["SOLVERS", "Listed", "load", "solver_name"]


class Listed(NamedTuple):
    """What a solver is for, and the module that defines it under the solver's name.

    `scans`: how many it registers; `upright`: the axis z of all of them is vertical.
    """

    module: str
    scans: int
    upright: bool = False


SOLVERS = {
    "pairwise": Listed("miniloop_cli.solvers.pairwise", 2),
    "cycle3": Listed("miniloop_cli.solvers.cycle3", 3),
    "cycle4": Listed("miniloop_cli.solvers.cycle4", 4),
    "cycle5": Listed("miniloop_cli.solvers.cycle5", 5),
    "planar2": Listed("miniloop_cli.solvers.planar2", 2, upright=True),
    "planar3": Listed("miniloop_cli.solvers.planar3", 3, upright=True),
    "planar4": Listed("miniloop_cli.solvers.planar4", 4, upright=True),
    "cycle6": Listed("miniloop_cli.solvers.long_cycles.cycle6", 6),
    "cycle7": Listed("miniloop_cli.solvers.long_cycles.cycle7", 7),
}


def load(name: str) -> MinimalSolver:
    """The solver of this name. Raises MiniloopError if there is none."""
    if name not in SOLVERS:
        raise MiniloopError(f"there is no solver {name!r}; choose one of {', '.join(SOLVERS)}")
    solver: MinimalSolver = getattr(import_module(SOLVERS[name].module), name)
    return solver


def solver_name(scans: int, upright: bool = False) -> str:
    """The name of the solver of so many scans, the last one listed. Raises MiniloopError if there is none."""
    names = [name for name, listed in SOLVERS.items() if (listed.scans, listed.upright) == (scans, upright)]
    if not names:
        raise MiniloopError(f"there is no solver for {scans} scans{' with a known vertical' * upright}")
    return names[-1]
