"""Three scans, 2+2+1 matches (paper, sec. 2.3): two angles from the one match that closes the cycle.

With v(a) = K2 L(a) p the closing match asks for q = L(b) v. A rotation about z keeps z and the norm, so b drops out of
    v_z = q_z   and   |v|^2 = |q|^2,
both linear in x = (cos a, sin a): A x = y. The image of the circle |x| = 1 under A is an ellipse, and the least-squares
angle is its point nearest to y, which is unique off the axes of the ellipse: a secular equation, solved by a
monotone Newton iteration after the singular value decomposition of A. The second equation is taken as
(|v|^2 - |q|^2) / 2 - q_z (v_z - q_z), divided by the radius of q: to first order the error of the radius, so that the
residual of both is the distance that is left between the two circles on which the closing points move.
Then e^{ib} = q / v as complex numbers.

13 constraints on 12 degrees of freedom: one solution. (The paper uses the z row and the circle: two solutions for each
of two angles that it takes to be independent.) Only where the axes meet, as when both edges match the same point of
scan 2, or are parallel, the equations say the same: the ellipse is a segment, and two mirrored angles are solutions.
Filtered: coincident points, a common axis, closing points on an axis.
Source: own derivation; the same problem is "subproblem 2 extended" in Elias & Wen, IK-Geo, 2022.
"""

from __future__ import annotations

import math

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import (
    OPTIONS,
    aligned,
    at,
    axis_frame,
    back_translation,
    joint,
    off_axis,
    turned,
    turned_norm,
    unit,
    write_edge,
)
from miniloop_cli.solvers._kernels.polynomials import NEARLY_REAL
from miniloop_cli.solvers.batch import run_batch, run_single
from miniloop_cli.typing import Floats, Ints

MATCHES = (2, 2, 1)
MAX_SOLUTIONS = 2
# Below this ratio of its half axes the ellipse is a segment.
FLATTEST = 1e-6
# Mirrored solutions nearer than this (rad) are one.
MIRRORED = 1e-7


@njit(**OPTIONS)
def nearest_on_circle(
    z: tuple[float, float, float], n: tuple[float, float, float], z_value: float, n_value: float
) -> tuple[complex, complex, int]:
    """Least squares of z(a) = z_value, n(a) = n_value, coefficients of (1, cos, sin): e^{ia}, mirrored, how many."""
    y0, y1 = z_value - z[0], n_value - n[0]
    # A = U diag(s1, s2) V^T by one Jacobi rotation of the columns; V = [[k, -m], [m, k]].
    e, f, g = z[1] * z[1] + n[1] * n[1], z[1] * z[2] + n[1] * n[2], z[2] * z[2] + n[2] * n[2]
    difference = e - g
    root = math.sqrt(difference * difference + 4 * f * f)
    k = math.sqrt(0.5 * (1 + abs(difference) / root)) if root > 0 else 1.0
    m = f / (root * k) if root > 0 else 0.0
    if difference < 0:
        k, m = abs(m), math.copysign(k, f)
    a0, a1 = k * z[1] + m * z[2], k * n[1] + m * n[2]
    b0, b1 = k * z[2] - m * z[1], k * n[2] - m * n[1]
    A, B = a0 * a0 + a1 * a1, b0 * b0 + b1 * b1
    a, b = a0 * y0 + a1 * y1, b0 * y0 + b1 * y1
    major = complex(k, m)
    if not B > FLATTEST * FLATTEST * A:
        u = a / A
        if not (A > 0 and abs(u) < 1 + 0.5 * NEARLY_REAL * NEARLY_REAL):
            return major, major, 0
        u = min(max(u, -1.0), 1.0)
        w = math.sqrt((1 - u) * (1 + u))
        return major * complex(u, w), major * complex(u, -w), 2 if w > MIRRORED else 1
    # Minimum of |A x - y| on |x| = 1: x = (A^T A + t)^-1 A^T y with the t > -B that makes x a unit vector.
    lowest = max(abs(a) - A, abs(b) - B)
    t = max(0.0, lowest)
    for _ in range(30):
        u, w = a / (A + t), b / (B + t)
        excess = u * u + w * w - 1
        step = 0.5 * excess / (u * u / (A + t) + w * w / (B + t))
        t = max(t + step, lowest)
        if not abs(step) > 1e-15 * (B + t):
            break
    turn, good = unit(major * complex(a / (A + t), b / (B + t)))
    return turn, turn, 1 if good else 0


@njit(**OPTIONS)
def solve(p: Floats, q: Floats, T: Floats) -> int:
    """p, q (5, 3) matches of the edges 1-2, 2-3 (two each), 1-3; T (2, 2, 3, 4) gets 1 -> 2 -> 3; returns 0 to 2."""
    H1, good_h1 = axis_frame(p, 0)
    G2, good_g2 = axis_frame(q, 0)
    H2, good_h2 = axis_frame(p, 2)
    G3, good_g3 = axis_frame(q, 2)
    if not (good_h1 and good_g2 and good_h2 and good_g3):
        return 0
    K2 = joint(H2, G2)
    a, b = aligned(H1, p, 4), aligned(G3, q, 4)
    if not (off_axis(H1, a) and off_axis(G3, b)):
        return 0
    z = turned(K2, 2, a)
    n = turned_norm(back_translation(K2), K2[9] * K2[9] + K2[10] * K2[10] + K2[11] * K2[11], a)
    radius2 = b[0] * b[0] + b[1] * b[1]
    scale = 1.0 / math.sqrt(radius2)
    n_row = scale * (n[0] - b[2] * z[0]), scale * (n[1] - b[2] * z[1]), scale * (n[2] - b[2] * z[2])
    first, mirrored, found = nearest_on_circle(z, n_row, b[2], 0.5 * scale * (radius2 - b[2] * b[2]))
    count = 0
    for i in range(found):
        e = mirrored if i else first
        x, y = at(turned(K2, 0, a), e.real, e.imag), at(turned(K2, 1, a), e.real, e.imag)
        turn, good = unit(complex(x, -y) * complex(b[0], b[1]))
        if good:
            write_edge(T, count, 0, H1, G2, e.real, e.imag)
            write_edge(T, count, 1, H2, G3, turn.real, turn.imag)
            count += 1
    return count


@njit(**OPTIONS)
def _solve_all(p: Floats, q: Floats, T: Floats, counts: Ints) -> None:
    for i in range(p.shape[0]):
        counts[i] = solve(p[i], q[i], T[i])


def solve_batch(p: Floats, q: Floats) -> tuple[Floats, Ints]:
    """Samples p, q (b, 5, 3) to solutions T (b, 2, 2, 3, 4) and counts (b,), one thread."""
    return run_batch(_solve_all, MATCHES, MAX_SOLUTIONS, p, q)


def cycle3(p: Floats, q: Floats, best: bool = False) -> Floats:
    """Scans 1 -> 2 -> 3 as (s, 2, 4, 4), s <= 2, from matches p, q (5, 3) of 1-2, 2-3 (two each), 1-3."""
    return run_single(solve_batch, MATCHES, p, q, best)
