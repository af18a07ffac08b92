"""Two scans, three matches (paper, sec. 2.2): two of them give the axis, the third the angle about it.

In the aligned frames q = L(a) p is, seen as complex numbers x + iy, q = e^{ia} p: two linear equations in
(cos a, sin a) whose least-squares solution on the circle is conj(p) q / |p q|. One solution; the paper solves one
of the two equations with the circle and gets two, of which one is an artefact.
The axis is the longest side of the triangle: the order of the matches does not matter, and a long baseline
is a better axis. Filtered: coincident points, a third match on the axis.
"""

from __future__ import annotations

import math

from numba import njit

from miniloop_cli.solvers.alignment import OPTIONS, Array, aligned, axis_frame, write_edge

MATCHES = (3,)
MAX_SOLUTIONS = 1


@njit(**OPTIONS)
def solve(p: Array, q: Array, T: Array) -> int:
    """p, q (3, 3) matches of scan 1 and scan 2; T (1, 1, 3, 4) receives scan 1 -> scan 2; returns 0 or 1."""
    H, good_h = axis_frame(p, 0)
    G, good_g = axis_frame(q, 0)
    a, b = aligned(H, p, 2), aligned(G, q, 2)
    c, s = a[0] * b[0] + a[1] * b[1], a[0] * b[1] - a[1] * b[0]
    norm = math.sqrt(c * c + s * s)
    if not (good_h and good_g and norm > 1e-300):
        return 0
    write_edge(T, 0, 0, H, G, c / norm, s / norm)
    return 1
