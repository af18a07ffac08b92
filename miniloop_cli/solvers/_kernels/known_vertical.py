"""What the solvers with a known vertical share: the axis z of every scan is the same, so one match replaces two.

An edge turns about the vertical through its matched point: T_e = G^-1 L(theta) H with mere translations H (p to the
origin) and G (q to the origin), so K_i = H_i G_i^-1 is a translation too. The xy parts of points are complex numbers,
a turn is a unit factor. This serves planar motion (paper, sec. 3) and, as z stays free, known gravity: 4 degrees of
freedom an edge.
The z rows do not depend on the angles; their closing error is spread over the edges by least squares.
"""

from __future__ import annotations

import math

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS, TINY, unit
from miniloop_cli.solvers._kernels.polynomials import NEARLY_REAL
from miniloop_cli.typing import Floats


@njit(**OPTIONS)
def xy(points: Floats, i: int) -> complex:
    """The horizontal part of row i of points (n, 3)."""
    return complex(points[i, 0], points[i, 1])


@njit(**OPTIONS)
def height_change(p: Floats, q: Floats, i: int) -> float:
    """How much z grows from p (n, 3) to q (n, 3) by match i."""
    return q[i, 2] - p[i, 2]


@njit(**OPTIONS)
def turns_reaching(s: complex, t: complex, reach: float) -> tuple[complex, complex, int]:
    """Unit numbers w with |s + w t| = reach, by the law of cosines: two, or one where they (nearly) coincide, or none.

    A complex pair with an imaginary part below NEARLY_REAL (rad) counts as coincident.
    """
    direction, good = unit(s * t.conjugate())
    scale = 2 * abs(s) * abs(t)
    c = (reach * reach - (s * s.conjugate() + t * t.conjugate()).real) / scale
    excess = abs(c) - 1
    if not (good and scale > TINY and excess < 0.5 * NEARLY_REAL * NEARLY_REAL):
        return direction, direction, 0
    if excess >= 0:
        direction *= math.copysign(1.0, c)
        return direction, direction, 1
    root = math.sqrt((1 - c) * (1 + c))
    return direction * complex(c, root), direction * complex(c, -root), 2


@njit(**OPTIONS)
def finite(p: Floats, q: Floats) -> bool:
    """Whether all coordinates of p (n, 3) and q (n, 3) are finite."""
    total = 0.0
    for i in range(p.shape[0]):
        for k in range(3):
            total += abs(p[i, k]) + abs(q[i, k])
    return total < math.inf


@njit(**OPTIONS)
def write_upright(T: Floats, s: int, e: int, p: Floats, q: Floats, turn: complex, up: float) -> None:
    """T[s, e] = [R | t], T (s, e, 3, 4): R turns about z, t moves the xy of p[e] to that of q[e] and lifts by `up`."""
    shift = xy(q, e) - turn * xy(p, e)
    for row in range(3):
        for column in range(4):
            T[s, e, row, column] = 0.0
    T[s, e, 0, 0], T[s, e, 0, 1], T[s, e, 0, 3] = turn.real, -turn.imag, shift.real
    T[s, e, 1, 0], T[s, e, 1, 1], T[s, e, 1, 3] = turn.imag, turn.real, shift.imag
    T[s, e, 2, 2], T[s, e, 2, 3] = 1.0, up
