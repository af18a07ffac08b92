"""Four scans with a known vertical, 1+1+1+2 matches: at most 2 solutions.

The paper's 1+1+1+1 (sec. 3, "16 solutions") is under-determined: four matches give 8 equations in the plane for 9
unknowns, and the z rows do not depend on turns about z. It has a one-parameter family of solutions, not 16 poses. A
second closing match makes it well posed: a planar arm of three links with a given hand pose. With t_i = q_{i-1} - p_i
in scan i and the closing matches relative to p_1 and q_3, xy parts as complex numbers obey
    q_k = C (t_3 + B (t_2 + A p_k)),   k = 1, 2.
Their difference gives the turn of the hand, F = A B C = (q_2 - q_1) / (p_2 - p_1); then A B (q / F - p) = t_3 + B t_2
for the midpoints p, q, and |t_3 + B t_2| = |q / F - p| is the law of cosines: two mirrored B.
Filtered: closing matches one above the other, t_2 or t_3 vertical (no link), arms out of reach.
"""

from __future__ import annotations

from miniloop_cli.solvers._kernels.alignment import unit
from miniloop_cli.solvers._kernels.known_vertical import finite, height_change, turns_reaching, write_upright, xy
from miniloop_cli.solvers.batch import minimal_solver
from miniloop_cli.typing import Floats


@minimal_solver(matches=(1, 1, 1, 2), solutions=2)
def planar4(p: Floats, q: Floats, T: Floats) -> int:
    """p, q (5, 3) matches of 1-2, 2-3, 3-4, then two of 1-4; T (2, 3, 3, 4) gets 1 -> 2 -> 3 -> 4; returns 0 to 2."""
    t2, t3 = xy(q, 0) - xy(p, 1), xy(q, 1) - xy(p, 2)
    hand, good_hand = unit((xy(p, 4) - xy(p, 3)).conjugate() * (xy(q, 4) - xy(q, 3)))
    a, b = 0.5 * (xy(p, 3) + xy(p, 4)) - xy(p, 0), 0.5 * (xy(q, 3) + xy(q, 4)) - xy(q, 2)
    way = hand.conjugate() * b - a
    first, second, found = turns_reaching(t3, t2, abs(way))
    up1, up2, up3 = height_change(p, q, 0), height_change(p, q, 1), height_change(p, q, 2)
    # Least squares with unit variance a match: the closing height_change is the mean of two.
    spread = (0.5 * (height_change(p, q, 3) + height_change(p, q, 4)) - up1 - up2 - up3) / 3.5
    count = 0
    for i in range(found):
        B = first if i == 0 else second
        AB, good = unit((t3 + B * t2) * way.conjugate())
        if good and good_hand and finite(p, q):
            write_upright(T, count, 0, p, q, AB * B.conjugate(), up1 + spread)
            write_upright(T, count, 1, p, q, B, up2 + spread)
            write_upright(T, count, 2, p, q, hand * AB.conjugate(), up3 + spread)
            count += 1
    return count
