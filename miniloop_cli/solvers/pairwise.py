"""Two scans, three matches (paper, sec. 2.2): two of them give the axis, the third the angle about it.

In the aligned frames q = L(a) p is, seen as complex numbers x + iy, q = e^{ia} p: two linear equations in
(cos a, sin a) whose least-squares solution on the circle is conj(p) q / |p q|. One solution; the paper solves one
of the two equations with the circle and gets two, of which one is an artefact.
The axis is the longest side of the triangle: the result does not depend on the order of the matches, and a long
baseline gives a more accurate axis. Filtered: coincident points, a third match on the axis.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS, aligned, frame_through, off_axis, unit, write_edge
from miniloop_cli.solvers.batch import minimal_solver
from miniloop_cli.typing import Floats


@njit(**OPTIONS)
def _third(p: Floats) -> int:
    """The corner of the triangle p (3, 3) that lies opposite its longest side."""
    a, b, c = 0.0, 0.0, 0.0
    for k in range(3):
        a += (p[1, k] - p[2, k]) ** 2
        b += (p[2, k] - p[0, k]) ** 2
        c += (p[0, k] - p[1, k]) ** 2
    return 0 if a >= b and a >= c else 1 if b >= c else 2


@minimal_solver(matches=(3,), solutions=1)
def pairwise(p: Floats, q: Floats, T: Floats) -> int:
    """p, q (3, 3) matches of scan 1 and scan 2; T (1, 1, 3, 4) receives scan 1 -> scan 2; returns 0 or 1."""
    k = _third(p)
    i, j = (k + 1) % 3, (k + 2) % 3
    H, G = np.empty(12), np.empty(12)
    good = frame_through(p[i], p[j], H)
    good &= frame_through(q[i], q[j], G)
    a, b = aligned(H, p[k]), aligned(G, q[k])
    turn, determined = unit(complex(a[0], -a[1]) * complex(b[0], b[1]))
    if not (good and off_axis(H, a) and off_axis(G, b) and determined):
        return 0
    write_edge(T[0, 0], H, G, turn.real, turn.imag)
    return 1
