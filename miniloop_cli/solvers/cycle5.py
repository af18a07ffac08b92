"""Five scans, 2+2+2+2+2 matches (paper, sec. 2.5): an octic instead of a Groebner basis with 32 solutions.

Meet in the middle. For the closing matches i = 1, 2 let v_i(a) = K2 L(a) p_i, x_i = K3 L(b) v_i and
y_i = K4^-1 L(d)^-1 q_i; the loop closes if y_i = L(g) x_i. A rotation about z keeps z and the norm, so g drops out:
x_iz = y_iz and |x_i|^2 = |y_i|^2.
With K3 = [R | t], r the third row of R, u = R^T t, and r', u' the same of K4^-1, these are, for the xy parts
w_i = L(b) v_i and w'_i = L(d)^-1 q_i,
    M w_i + e_i = M' w'_i,   M = [[r_x, r_y], [u_x, u_y]],  M' likewise (both constant),
    e_i = (r_z v_iz + t_z - r'_z q_iz - t'_z,  (|v_i|^2 + |t|^2 - |q_i|^2 - |t'|^2) / 2 + u_z v_iz - u'_z q_iz),
with e_i and v_i linear in (cos a, sin a). Now let xy parts be complex numbers: w_i = v_i B and w'_i = q_i D with unit
numbers B = e^{ib}, D = e^{-id}, and M'^-1 M acts as w -> m w + n conj(w). So
    q_i D = m v_i B + n conj(v_i B) + h_i,   h_i = M'^-1 e_i.
Eliminating D from i = 1, 2 leaves
    P B + Q conj(B) = h,   P = m (q_2 v_1 - q_1 v_2),  Q = n (q_2 conj(v_1) - q_1 conj(v_2)),  h = q_1 h_2 - q_2 h_1,
and with its conjugate B = (conj(P) h - Q conj(h)) / (|P|^2 - |Q|^2) = N / W. |B| = 1 is |N|^2 = W^2: a trigonometric
polynomial of degree 4 in a, an octic in tan(a/2). D then follows from both closing matches in the least-squares sense,
and so does g.

At most 8 solutions (paper: 32). |D| = 1 is not used: the 25 constraints exceed the 24 degrees of freedom by one, and
the closing residual ranks the solutions, best first. Where axes 2, 3 or 3, 4 are parallel or meet (both edges match the
same point) M or M' is singular: the cycle is then read from another scan. Filtered: coincident points, cycles singular
from every scan, closing points on an axis.
Source: own derivation.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import (
    OPTIONS,
    Motion,
    Point,
    aligned,
    apply,
    back_translation,
    crossing,
    edge_frames,
    joint,
    off_axis,
    turned,
    turned_norm,
    unapply,
    unit,
    write_edge,
)
from miniloop_cli.solvers._kernels.closing import close_loop, equidistant
from miniloop_cli.solvers._kernels.cycle_rotation import poses_from_rotated, rotated_matches
from miniloop_cli.solvers._kernels.polynomials import NEARLY_REAL, ROWS, roots_on_circle
from miniloop_cli.solvers._kernels.trig_polynomials import Waves, conj, mix, norm_excess, product, value, waves
from miniloop_cli.solvers.batch import minimal_solver
from miniloop_cli.typing import Floats

MAX_SOLUTIONS = 8
# The least `crossing` of two axes that still determines a matrix.
SINGULAR = 1e-9


@njit(**OPTIONS)
def _offset(
    K3: Motion,
    u: Point,
    z: Point,
    n: Point,
    z_value: float,
    n_value: float,
    M: tuple[float, float, float, float],
) -> Waves:
    """adj(M') e_i; z: of v_i, n: half of |v_i|^2 + |t|^2, z_value and n_value: the same of the other side."""
    e = K3[8] * z[0] + K3[11] - z_value, K3[8] * z[1], K3[8] * z[2]
    f = n[0] + u[2] * z[0] - n_value, n[1] + u[2] * z[1], n[2] + u[2] * z[2]
    return waves(
        (M[3] * e[0] - M[1] * f[0], M[3] * e[1] - M[1] * f[1], M[3] * e[2] - M[1] * f[2]),
        (M[0] * f[0] - M[2] * e[0], M[0] * f[1] - M[2] * e[1], M[0] * f[2] - M[2] * e[2]),
    )


@njit(**OPTIONS)
def _solve_from_first(p: Floats, q: Floats, T: Floats, nearly_real: float) -> int:
    """Like `cycle5`, but -1 if M or M' is singular: then the cycle has to be read from another scan."""
    room, found = np.empty((ROWS + 10, 12)), np.empty((8, 8))
    memory, H, G = room[:ROWS], room[ROWS : ROWS + 5], room[ROWS + 5 :]
    if not edge_frames(p, q, H, G):
        return 0
    K2, K3, K4 = joint(H[1], G[0]), joint(H[2], G[1]), joint(H[3], G[2])
    p1, p2, q1, q2 = equidistant(aligned(H[0], p[8]), aligned(H[0], p[9]), aligned(G[3], q[8]), aligned(G[3], q[9]))
    if not (off_axis(H[0], p1) or off_axis(H[0], p2)) or not (off_axis(G[3], q1) or off_axis(G[3], q2)):
        return 0
    u, back = back_translation(K3), back_translation(K4)
    M = K3[6], K3[7], u[0], u[1]
    N = K4[2], K4[5], -K4[9], -K4[10]
    t2, s2 = (
        K3[9] * K3[9] + K3[10] * K3[10] + K3[11] * K3[11],
        K4[9] * K4[9] + K4[10] * K4[10] + K4[11] * K4[11],
    )
    if min(abs(crossing(K3)), abs(crossing(K4))) < SINGULAR:
        return -1
    # adj(M') M = w -> m w + n conj(w); the determinant of M' is left out on both sides.
    a00, a01 = N[3] * M[0] - N[1] * M[2], N[3] * M[1] - N[1] * M[3]
    a10, a11 = N[0] * M[2] - N[2] * M[0], N[0] * M[3] - N[2] * M[1]
    m, n = 0.5 * complex(a00 + a11, a10 - a01), 0.5 * complex(a00 - a11, a10 + a01)
    u2 = back_translation(K2)
    k2 = K2[9] * K2[9] + K2[10] * K2[10] + K2[11] * K2[11] + t2
    (x1, y1, z1), (x2, y2, z2) = turned(K2, p1), turned(K2, p2)
    v1, v2 = waves(x1, y1), waves(x2, y2)
    c1, c2 = complex(q1[0], q1[1]), complex(q2[0], q2[1])
    half1 = 0.5 * (q1[0] * q1[0] + q1[1] * q1[1] + q1[2] * q1[2] + s2) - K4[11] * q1[2]
    half2 = 0.5 * (q2[0] * q2[0] + q2[1] * q2[1] + q2[2] * q2[2] + s2) - K4[11] * q2[2]
    h1 = _offset(K3, u, z1, turned_norm(u2, k2, p1), K4[8] * q1[2] - back[2], half1, N)
    h2 = _offset(K3, u, z2, turned_norm(u2, k2, p2), K4[8] * q2[2] - back[2], half2, N)
    P = mix(m * c2, v1, -m * c1, v2)
    Q = mix(n * c2, conj(v1), -n * c1, conj(v2))
    h = mix(c1, h2, -c2, h1)
    x, y = product(conj(P), h), product(Q, conj(h))
    B = x[0] - y[0], x[1] - y[1], x[2] - y[2], x[3] - y[3], x[4] - y[4]
    x, y = product(conj(P), P), product(conj(Q), Q)
    W = complex(x[2].real - y[2].real, 0.0), x[3] - y[3], x[4] - y[4]

    order, residuals = np.empty(8, np.int64), np.empty(8)
    norm_excess(B, W, memory[0])

    count = 0
    for i in range(roots_on_circle(memory, np.int64(4), nearly_real)):
        e = complex(memory[1, i], memory[2, i])
        Pa, Qa, ha = value(P, e), value(Q, e), value(h, e)
        b = (Pa.conjugate() * ha - Qa * ha.conjugate()) * (abs(Pa) - abs(Qa))
        b, good_b = unit(b)
        w1, w2 = value(v1, e) * b, value(v2, e) * b
        zv1 = z1[0] + z1[1] * e.real + z1[2] * e.imag
        zv2 = z2[0] + z2[1] * e.real + z2[2] * e.imag
        d = c1.conjugate() * (m * w1 + n * w1.conjugate() + value(h1, e))
        d += c2.conjugate() * (m * w2 + n * w2.conjugate() + value(h2, e))
        d *= N[0] * N[3] - N[1] * N[2]
        d, good_d = unit(d)
        a1, a2 = apply(K3, w1.real, w1.imag, zv1), apply(K3, w2.real, w2.imag, zv2)
        w1, w2 = c1 * d, c2 * d
        b1, b2 = unapply(K4, w1.real, w1.imag, q1[2]), unapply(K4, w2.real, w2.imag, q2[2])
        g = complex(a1[0], -a1[1]) * complex(b1[0], b1[1]) + complex(a2[0], -a2[1]) * complex(b2[0], b2[1])
        g, good_g = unit(g)
        if not (good_b and good_d and good_g):
            continue
        found[count, 0], found[count, 1], found[count, 2], found[count, 3] = e.real, e.imag, b.real, b.imag
        found[count, 4], found[count, 5], found[count, 6], found[count, 7] = g.real, g.imag, d.real, -d.imag
        residual = close_loop(K2, K3, K4, (p1, p2), (q1, q2), found[count], memory[3:])
        k = count
        while k > 0 and residuals[k - 1] > residual:
            order[k], residuals[k] = order[k - 1], residuals[k - 1]
            k -= 1
        order[k], residuals[k] = count, residual
        count += 1
    for s in range(count):
        k = order[s]
        for edge in range(4):
            write_edge(T[s, edge], H[edge], G[edge], found[k, 2 * edge], found[k, 2 * edge + 1])
    return count


@minimal_solver(matches=(2, 2, 2, 2, 2), solutions=MAX_SOLUTIONS, nearly_real=NEARLY_REAL)
def cycle5(p: Floats, q: Floats, T: Floats, nearly_real: float) -> int:
    """p, q (10, 3) matches, two each of 1-2, 2-3, 3-4, 4-5, 1-5; T (8, 4, 3, 4) receives 1 -> 2 -> 3 -> 4 -> 5.

    Returns the number of solutions, 0 to 8, best closing residual first. Complex pairs with an imaginary part below
    `nearly_real` (rad) give their real part, 0: none.
    """
    new_p, new_q, new_T = p, q, T
    for start in range(5):
        if start == 1:
            new_p, new_q, new_T = np.empty((10, 3)), np.empty((10, 3)), np.empty((MAX_SOLUTIONS, 4, 3, 4))
        if start:
            rotated_matches(start, p, q, new_p, new_q)
        count = _solve_from_first(new_p, new_q, new_T, nearly_real)
        if count >= 0:
            for s in range(count if start else 0):
                poses_from_rotated(start, new_T, T, s)
            return count
    return 0
