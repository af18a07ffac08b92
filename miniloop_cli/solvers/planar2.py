"""Two scans with a known vertical, two matches (paper, sec. 3): one solution.

As complex numbers the horizontal differences obey q_2 - q_1 = e^{ia} (p_2 - p_1): the least-squares angle is that of
conj(p_2 - p_1) (q_2 - q_1). The translation joins the midpoints. (The paper counts two solutions; the one that comes
from squaring is an artefact.) Filtered: matches one above the other.
"""

from __future__ import annotations

from miniloop_cli.solvers._kernels.alignment import unit
from miniloop_cli.solvers._kernels.known_vertical import finite, height_change, write_upright, xy
from miniloop_cli.solvers.batch import minimal_solver
from miniloop_cli.typing import Floats


@minimal_solver(matches=(2,), solutions=1)
def planar2(p: Floats, q: Floats, T: Floats) -> int:
    """p, q (2, 3) matches of scan 1 and scan 2; T (1, 1, 3, 4) receives scan 1 -> scan 2; returns 0 or 1."""
    dp, dq = xy(p, 1) - xy(p, 0), xy(q, 1) - xy(q, 0)
    turn, good = unit(dp.conjugate() * dq)
    if not (good and finite(p, q)):
        return 0
    write_upright(T, 0, 0, p, q, turn, 0.5 * (height_change(p, q, 0) + height_change(p, q, 1)))
    # So far the first match closes exactly: share the error of the second between both.
    misfit = 0.5 * (dq - turn * dp)
    T[0, 0, 0, 3] += misfit.real
    T[0, 0, 1, 3] += misfit.imag
    return 1
