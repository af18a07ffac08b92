"""Three scans, 2+2+1 matches (paper, sec. 2.3): two angles from the one match that closes the cycle.

With v(a) = K2 L(a) p the closing match requires q = L(b) v. A rotation about z keeps z and the norm, so b drops out of
    v_z = q_z   and   |v|^2 = |q|^2,
both linear in x = (cos a, sin a): A x = y. The image of the circle |x| = 1 under A is an ellipse, and the least-squares
angle is its point nearest to y, which is unique off the axes of the ellipse: a secular equation, solved by a
monotone Newton iteration after the singular value decomposition of A. The second equation is replaced by
(|v|^2 - |q|^2) / 2 - q_z (v_z - q_z), divided by the radius of q: to first order the error of the radius, so that the
residual of both is the distance that is left between the two circles on which the closing points move.
Then e^{ib} = q / v as complex numbers.

13 constraints on 12 degrees of freedom: one solution. (The paper uses the z row and the circle: two solutions for each
of two angles that it treats as independent.) If the axes are parallel or meet, as when both edges match the same point
of scan 2, the two equations are dependent: the ellipse is a segment, and two mirrored angles are solutions.
Filtered: coincident points, a common axis, closing points on an axis.
Source: own derivation; the same problem is "subproblem 2 extended" in Elias & Wen, IK-Geo, 2022.
"""

from __future__ import annotations

import math

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import (
    OPTIONS,
    aligned,
    at,
    back_translation,
    edge_frames,
    joint,
    off_axis,
    turned,
    turned_norm,
    unit,
    write_edge,
)
from miniloop_cli.solvers._kernels.polynomials import NEARLY_REAL
from miniloop_cli.solvers.batch import minimal_solver
from miniloop_cli.typing import Floats

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


@minimal_solver(matches=(2, 2, 1), solutions=2)
def cycle3(p: Floats, q: Floats, T: Floats) -> int:
    """p, q (5, 3) matches of the edges 1-2, 2-3 (two each), 1-3; T (2, 2, 3, 4) gets 1 -> 2 -> 3; returns 0 to 2."""
    frames = np.empty((4, 12))
    H, G = frames[:2], frames[2:]
    if not edge_frames(p, q, H, G):
        return 0
    K2 = joint(H[1], G[0])
    a, b = aligned(H[0], p[4]), aligned(G[1], q[4])
    if not (off_axis(H[0], a) and off_axis(G[1], b)):
        return 0
    vx, vy, z = turned(K2, a)
    n = turned_norm(back_translation(K2), K2[9] * K2[9] + K2[10] * K2[10] + K2[11] * K2[11], a)
    radius2 = b[0] * b[0] + b[1] * b[1]
    scale = 1.0 / math.sqrt(radius2)
    n_row = scale * (n[0] - b[2] * z[0]), scale * (n[1] - b[2] * z[1]), scale * (n[2] - b[2] * z[2])
    first, mirrored, found = nearest_on_circle(z, n_row, b[2], 0.5 * scale * (radius2 - b[2] * b[2]))
    count = 0
    for i in range(found):
        e = mirrored if i else first
        x, y = at(vx, e.real, e.imag), at(vy, e.real, e.imag)
        turn, good = unit(complex(x, -y) * complex(b[0], b[1]))
        if good:
            write_edge(T[count, 0], H[0], G[0], e.real, e.imag)
            write_edge(T[count, 1], H[1], G[1], turn.real, turn.imag)
            count += 1
    return count
