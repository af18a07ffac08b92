"""Two scans with a known vertical, two matches (paper, sec. 3): one solution.

As complex numbers the horizontal differences obey q_2 - q_1 = e^{ia} (p_2 - p_1): the least-squares angle is that of
conj(p_2 - p_1) (q_2 - q_1). The translation joins the midpoints. (The paper counts two solutions; the one that comes
from squaring is an artefact.) Filtered: matches one above the other.
"""

from __future__ import annotations

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS, unit
from miniloop_cli.solvers._kernels.known_vertical import finite, height_change, write_upright, xy
from miniloop_cli.solvers.batch import run_batch, run_single
from miniloop_cli.typing import Floats, Ints

MATCHES = (2,)
MAX_SOLUTIONS = 1


@njit(**OPTIONS)
def solve(p: Floats, q: Floats, T: Floats) -> int:
    """p, q (2, 3) matches of scan 1 and scan 2; T (1, 1, 3, 4) receives scan 1 -> scan 2; returns 0 or 1."""
    dp, dq = xy(p, 1) - xy(p, 0), xy(q, 1) - xy(q, 0)
    turn, good = unit(dp.conjugate() * dq)
    if not (good and finite(p, q)):
        return 0
    write_upright(T, 0, 0, p, q, turn, 0.5 * (height_change(p, q, 0) + height_change(p, q, 1)))
    # The first matches meet exactly so far: share the misfit of the second.
    misfit = 0.5 * (dq - turn * dp)
    T[0, 0, 0, 3] += misfit.real
    T[0, 0, 1, 3] += misfit.imag
    return 1


@njit(**OPTIONS)
def _solve_all(p: Floats, q: Floats, T: Floats, counts: Ints) -> None:
    for i in range(p.shape[0]):
        counts[i] = solve(p[i], q[i], T[i])


def solve_batch(p: Floats, q: Floats) -> tuple[Floats, Ints]:
    """Samples p, q (b, 2, 3) to solutions T (b, 1, 1, 3, 4) and counts (b,), one thread."""
    return run_batch(_solve_all, MATCHES, MAX_SOLUTIONS, p, q)


def planar2(p: Floats, q: Floats, best: bool = False) -> Floats:
    """Scan 1 -> scan 2 as (1, 1, 4, 4), or (0, 1, 4, 4), from matches p, q (2, 3); z is vertical."""
    return run_single(solve_batch, MATCHES, p, q, best)
