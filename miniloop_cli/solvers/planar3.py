"""Three scans with a known vertical, 1+1+1 matches (paper, sec. 3): at most 2 solutions (paper: 4).

Let t = q_1 - p_2, the vector in scan 2 from its match with scan 3 to its match with scan 1. With the closing match
(p, q) relative to p_1 and q_2, the xy parts as complex numbers obey q = B (t + A p), |A| = |B| = 1: a
planar arm of two links that has to reach q. |t + A p| = |q| is the law of cosines: two mirrored A, then
B = q / (t + A p).
9 constraints on 8 degrees of freedom, but the ninth (z) is the same for both mirrored arms.
Filtered: a match vertically above another in the same scan (no arm), arms out of reach.
"""

from __future__ import annotations

from miniloop_cli.solvers._kernels.alignment import unit
from miniloop_cli.solvers._kernels.known_vertical import finite, height_change, turns_reaching, write_upright, xy
from miniloop_cli.solvers.batch import minimal_solver
from miniloop_cli.typing import Floats


@minimal_solver(matches=(1, 1, 1), solutions=2)
def planar3(p: Floats, q: Floats, T: Floats) -> int:
    """p, q (3, 3) matches of 1-2, 2-3, 1-3; T (2, 2, 3, 4) receives 1 -> 2 -> 3; returns 0 to 2."""
    a, b, t = xy(p, 2) - xy(p, 0), xy(q, 2) - xy(q, 1), xy(q, 0) - xy(p, 1)
    first, second, found = turns_reaching(t, a, abs(b))
    up1, up2 = height_change(p, q, 0), height_change(p, q, 1)
    spread = (height_change(p, q, 2) - up1 - up2) / 3
    count = 0
    for i in range(found):
        A = first if i == 0 else second
        B, good = unit(b * (t + A * a).conjugate())
        if good and finite(p, q):
            write_upright(T, count, 0, p, q, A, up1 + spread)
            write_upright(T, count, 1, p, q, B, up2 + spread)
            count += 1
    return count
