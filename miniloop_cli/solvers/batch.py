"""`@minimal_solver` makes a `MinimalSolver`, for one sample or for many, from a compiled function.

The module of a solver defines a function `name(p, q, T) -> count`, which numba compiles. Matches are listed edge by
edge, `p` in the earlier scan of an edge and `q` in the later, the closing edge last. Solution s maps scan e to scan
e + 1 by `T[s, e] = [R | t]`; rows of T from `count` on are not written.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType

import numpy as np

from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS
from miniloop_cli.typing import Floats, Ints


class MinimalSolver:
    """A minimal solver, called with one sample: `solver(p, q)`; `solve_batch` takes many, `solve` is compiled.

    `matches`: how many each edge gives, the closing edge last. `max_solutions`: the bound on their number.
    `nearly_real`: default of the largest imaginary part (rad) of a complex pair of roots that gives its real part; None
    for solvers without complex roots.
    """

    def __init__(
        self, core: Callable[..., int], matches: tuple[int, ...], solutions: int, nearly_real: float | None
    ) -> None:
        self.name, self.__doc__, self.__module__ = core.__name__, core.__doc__, core.__module__
        self.matches, self.max_solutions, self.nearly_real = matches, solutions, nearly_real
        # Compiled for callers; the loop contains its own copy.
        self.solve = njit(**OPTIONS)(core)
        self._solve_all = njit(**OPTIONS)(_loop_over(core, _solve_all if nearly_real is None else _solve_all_within))

    def solve_batch(self, p: Floats, q: Floats, nearly_real: float | None = None) -> tuple[Floats, Ints]:
        """Solutions T (b, solutions, n-1, 3, 4) and their counts (b,) of samples p, q (b, k, 3); unused slots are zero.

        `nearly_real` (rad) in place of the solver's own, if it has one. Raises MiniloopError if a shape is wrong.
        """
        p, q = np.ascontiguousarray(p, float), np.ascontiguousarray(q, float)
        k = sum(self.matches)
        if p.ndim != 3 or p.shape[1:] != (k, 3) or p.shape != q.shape:
            raise MiniloopError(f"this solver takes samples p, q (b, {k}, 3), got {p.shape} and {q.shape}")
        T = np.zeros((len(p), self.max_solutions, max(len(self.matches), 2) - 1, 3, 4))
        counts = np.zeros(len(p), np.int64)
        if self.nearly_real is None:
            self._solve_all(p, q, T, counts)
        else:
            self._solve_all(p, q, T, counts, self.nearly_real if nearly_real is None else nearly_real)
        return T, counts

    def __call__(self, p: Floats, q: Floats, best: bool = False) -> Floats:
        """Solutions (s, n-1, 4, 4) of one sample p, q (k, 3); with `best`, only that with the least residual.

        Raises MiniloopError if a shape is wrong.
        """
        T, counts = self.solve_batch(np.asarray(p, float)[None], np.asarray(q, float)[None])
        poses = se3.pose(T[0, : counts[0], ..., :3], T[0, : counts[0], ..., 3])
        if best and len(poses) > 1:
            residuals = np.linalg.norm(match_residuals(poses, p, q, self.matches), axis=-1)
            poses = poses[[residuals.argmin()]]
        return poses


def minimal_solver(
    matches: tuple[int, ...], solutions: int, nearly_real: float | None = None
) -> Callable[[Callable[..., int]], MinimalSolver]:
    """Decorator: the solver of samples with so many `matches` an edge, which has at most so many `solutions`.

    With `nearly_real` the function takes it as fourth argument, and this is its default.
    """
    return lambda core: MinimalSolver(core, matches, solutions, nearly_real)


def solve(*arguments: object) -> int:
    """Placeholder in the loops below; `_loop_over` replaces it by a compiled solver. Raises NotImplementedError."""
    raise NotImplementedError


def _solve_all(p: Floats, q: Floats, T: Floats, counts: Ints) -> None:
    for i in range(p.shape[0]):
        counts[i] = solve(p[i], q[i], T[i])


def _solve_all_within(p: Floats, q: Floats, T: Floats, counts: Ints, nearly_real: float) -> None:
    for i in range(p.shape[0]):
        counts[i] = solve(p[i], q[i], T[i], nearly_real)


def _loop_over(core: Callable[..., int], loop: Callable[..., None]) -> FunctionType:
    """The loop with `solve` = core, for the compiler.

    numba does not cache a closure over another compiled function. The loop therefore gets its own globals, and the name
    and the file of the solver, under which numba caches it.
    """
    name, source = f"{core.__name__}_all", core.__code__
    code = loop.__code__.replace(
        co_name=name, co_qualname=name, co_filename=source.co_filename, co_firstlineno=source.co_firstlineno
    )
    named = {"__name__": core.__module__, "solve": njit(**OPTIONS, inline="always")(core), "range": range}
    return FunctionType(code, named, name)


def edges_of(matches: tuple[int, ...]) -> list[tuple[int, int]]:
    """The scans that each edge joins, counted from 0: a chain and, beyond two scans, its closing edge."""
    scans = max(len(matches), 2)
    chain = [(e, e + 1) for e in range(scans - 1)]
    return chain if len(matches) == 1 else [*chain, (0, scans - 1)]


def match_residuals(poses: Floats, p: Floats, q: Floats, matches: tuple[int, ...]) -> Floats:
    """Distances (..., k) of p, moved along the chain, from q: poses (..., n-1, 4, 4), p and q (..., k, 3) or (k, 3)."""
    chain = [poses[..., e, :, :] for e in range(poses.shape[-3])]
    if len(matches) > 1:
        closing = chain[0]
        for pose in chain[1:]:
            closing = pose @ closing
        chain.append(closing)
    T = np.repeat(np.stack(chain, axis=-3), matches, axis=-3)
    moved = np.einsum("...kij,...kj->...ki", T[..., :3, :3], p) + T[..., :3, 3]
    return np.linalg.norm(moved - q, axis=-1)
