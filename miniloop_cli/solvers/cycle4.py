"""Four scans, 2+2+2+1 matches (paper, sec. 2.4): a quartic instead of a Groebner basis with 16 solutions.

With v(a) = K2 L(a) p the closing match requires q = L(g) K3 L(b) v. A rotation about z keeps z and the norm: g drops
out. With w = L(b) v, K3 = [R | t], r the third row of R, u = R^T t (so |K3 w|^2 = |v|^2 + |t|^2 + 2 u.w), w_z = v_z:
    r_x w_x + r_y w_y = q_z - t_z - r_z v_z,
    u_x w_x + u_y w_y = (|q|^2 - |t|^2 - |v|^2) / 2 - u_z v_z.
The matrix on the left is constant, the right sides are linear in (cos a, sin a), hence so is (w_x, w_y). A rotation
keeps w_x^2 + w_y^2 = v_x^2 + v_y^2: a trigonometric polynomial of degree 2 in a, that is a quartic in tan(a/2). For
each root e^{ib} = w / v and e^{ig} = q / (K3 w) as complex numbers.

At most 4 solutions (paper: 16), on 18 degrees of freedom with 18 constraints: no equation is left to rank them.
Where axes 2 and 3 meet (both edges match the same point of scan 3) or are parallel the matrix is singular: the cycle is
then read backwards, which puts axes 1 and 2 in their place. Filtered: coincident points, both pairs of axes singular,
closing points on an axis.
Source: own derivation; the closed form is Pieper's (1968) for three revolute joints.
"""

from __future__ import annotations

import math

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import (
    OPTIONS,
    Motion,
    Point,
    aligned,
    apply,
    at,
    back_translation,
    backwards,
    crossing,
    edge_frames,
    joint,
    off_axis,
    turned,
    turned_norm,
    unit,
    write_edge,
)
from miniloop_cli.solvers._kernels.polynomials import NEARLY_REAL, ROWS, roots_on_circle
from miniloop_cli.solvers.batch import minimal_solver
from miniloop_cli.typing import Floats

# The least `crossing` of two axes that still determines the matrix.
SINGULAR = 1e-9


@njit(**OPTIONS)
def _close(K2: Motion, K3: Motion, p: Point, q: Point, memory: Floats, nearly_real: float) -> int:
    """Angles that close the loop, q = L(g) K3 L(b) K2 L(a) p: rows cos a, sin a, cos b, .. of memory[3:7]; how many."""
    vx, vy, vz = turned(K2, p)
    vv = turned_norm(back_translation(K2), K2[9] * K2[9] + K2[10] * K2[10] + K2[11] * K2[11], p)
    u = back_translation(K3)
    t2 = K3[9] * K3[9] + K3[10] * K3[10] + K3[11] * K3[11]
    z0, n0 = q[2] - K3[11], 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] - t2)
    z = z0 - K3[8] * vz[0], -K3[8] * vz[1], -K3[8] * vz[2]
    n = n0 - vv[0] - u[2] * vz[0], -vv[1] - u[2] * vz[1], -vv[2] - u[2] * vz[2]
    det = K3[6] * u[1] - K3[7] * u[0]
    # det times w: well scaled also where the matrix is nearly singular.
    wx = u[1] * z[0] - K3[7] * n[0], u[1] * z[1] - K3[7] * n[1], u[1] * z[2] - K3[7] * n[2]
    wy = K3[6] * n[0] - u[0] * z[0], K3[6] * n[1] - u[0] * z[1], K3[6] * n[2] - u[0] * z[2]
    d2, sign = det * det, math.copysign(1.0, det)
    f, cosines, sines, found = memory[0], memory[1], memory[2], memory[3:7]
    cc = wx[1] * wx[1] + wy[1] * wy[1] - d2 * (vx[1] * vx[1] + vy[1] * vy[1])
    ss = wx[2] * wx[2] + wy[2] * wy[2] - d2 * (vx[2] * vx[2] + vy[2] * vy[2])
    f[0] = wx[0] * wx[0] + wy[0] * wy[0] - d2 * (vx[0] * vx[0] + vy[0] * vy[0]) + 0.5 * (cc + ss)
    f[1] = 2 * (wx[0] * wx[1] + wy[0] * wy[1] - d2 * (vx[0] * vx[1] + vy[0] * vy[1]))
    f[2] = 2 * (wx[0] * wx[2] + wy[0] * wy[2] - d2 * (vx[0] * vx[2] + vy[0] * vy[2]))
    f[3] = 0.5 * (cc - ss)
    f[4] = wx[1] * wx[2] + wy[1] * wy[2] - d2 * (vx[1] * vx[2] + vy[1] * vy[2])
    count = 0
    for i in range(roots_on_circle(memory, np.int64(2), nearly_real)):
        c, s = cosines[i], sines[i]
        x, y = at(vx, c, s), at(vy, c, s)
        b, good_b = unit(complex(x, -y) * complex(at(wx, c, s) * sign, at(wy, c, s) * sign))
        x, y, _ = apply(K3, b.real * x - b.imag * y, b.imag * x + b.real * y, at(vz, c, s))
        g, good_g = unit(complex(x, -y) * complex(q[0], q[1]))
        if good_b and good_g:
            found[count, 0], found[count, 1], found[count, 2] = c, s, b.real
            found[count, 3], found[count, 4], found[count, 5] = b.imag, g.real, g.imag
            count += 1
    return count


@minimal_solver(matches=(2, 2, 2, 1), solutions=4, nearly_real=NEARLY_REAL)
def cycle4(p: Floats, q: Floats, T: Floats, nearly_real: float) -> int:
    """p, q (7, 3) matches of the edges 1-2, 2-3, 3-4 (two each) and 1-4; T (4, 3, 3, 4) receives 1 -> 2 -> 3 -> 4.

    Returns the number of solutions, 0 to 4. Complex pairs with an imaginary part below `nearly_real` (rad) give their
    real part, 0: none.
    """
    room = np.empty((ROWS + 6, 12))  # one allocation, as each costs as much as a root
    memory, H, G, found = room[:ROWS], room[ROWS : ROWS + 3], room[ROWS + 3 :], room[3:7]
    if not edge_frames(p, q, H, G):
        return 0
    K2, K3 = joint(H[1], G[0]), joint(H[2], G[1])
    start, end = aligned(H[0], p[6]), aligned(G[2], q[6])
    entered, left = abs(crossing(K2)), abs(crossing(K3))
    if not (off_axis(H[0], start) and off_axis(G[2], end) and max(entered, left) > SINGULAR):
        return 0
    # Read backwards, the cycle exchanges the roles of K2 and K3: take the direction in which the axes cross better.
    forwards = left >= entered
    if not forwards:
        K2, K3, start, end = backwards(K3), backwards(K2), end, start
    count = _close(K2, K3, start, end, memory, nearly_real)
    for i in range(count):
        for edge in range(3):
            k, sign = (2 * edge, 1.0) if forwards else (4 - 2 * edge, -1.0)
            write_edge(T[i, edge], H[edge], G[edge], found[i, k], sign * found[i, k + 1])
    return count
