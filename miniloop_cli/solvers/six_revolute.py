"""Inverse kinematics of a general chain of six revolute joints: all real solutions, at most 16.

1. The fourteen equations are reduced to six in three angles (six_revolute_equations).
2. Their resultant is a trigonometric polynomial of degree 8 in the third angle (six_revolute_resultant).
3. Its real roots are isolated by Descartes' rule (six_revolute_roots); each gives the other angles by linear algebra.
4. Newton's method on the closing error (six_revolute_closure) removes the rounding errors of 1-3; what does not close,
   coincides with another solution or can move (a degenerate chain) is dropped.
5. Where a real root is lost on the way, the chain is cut at the next joint, which makes another angle the hidden one,
   and the solutions are united.

Sources: Raghavan & Roth, "Inverse kinematics of the general 6R manipulator and related linkages", 1993; Manocha & Canny,
"Efficient inverse kinematics for general 6R manipulators", 1994, for the numerical view.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from miniloop_cli.solvers.alignment import OPTIONS, Array, Motion, joint
from miniloop_cli.solvers.six_revolute_closure import close, closing_error
from miniloop_cli.solvers.six_revolute_equations import axis_equations, reduce_equations
from miniloop_cli.solvers.six_revolute_resultant import angles_at, half_angle_forms, resultant
from miniloop_cli.solvers.six_revolute_roots import MAX_ROOTS, real_roots

MAX_SOLUTIONS = 16
# Closing error (rad, and in units of the mean link length) below which a chain is closed.
CLOSED = 1e-9
# Closing error before Newton's method above which rounding may have swallowed other roots.
ROUGH = 1e-6
# Ratio of pivots of the closing error's derivative below which the chain can move.
MOVABLE = 1e-11
# Double roots are torn into complex pairs by rounding, at most so far (rad).
TORN = 1e-3
# Two solutions all of whose angles (rad) agree to this are one.
SAME = 1e-6
_CUTS = 6


@njit(**OPTIONS)
def set_link(K: Array, e: int, H: Motion, G: Motion) -> None:
    """K[e] of (6, 3, 4) = H G^-1: the link entered through the axis of frame G and left through that of H."""
    k = joint(H, G)
    for i in range(3):
        for j in range(3):
            K[e, i, j] = k[3 * i + j]
        K[e, i, 3] = k[9 + i]


@njit(**OPTIONS)
def _other_angles(K: Array, S: Array, E: Array, a: Array) -> float:
    """Fill a (6,) from the hidden angle a[2], a root of the resultant; the closing error of what was found."""
    a4, a5 = angles_at(E, a[2])
    c3, s3 = math.cos(a[2]), math.sin(a[2])
    c4, s4, c5, s5 = math.cos(a4), math.sin(a4), math.cos(a5), math.sin(a5)
    m = (1.0, c4, s4, c5, c5 * c4, c5 * s4, s5, s5 * c4, s5 * s4)
    x = np.empty(8)  # cos a2, sin a2, cos a1 (1, cos a2, sin a2), sin a1 (1, cos a2, sin a2)
    for r in range(7, -1, -1):
        v = 0.0
        for i in range(9):
            v += (S[r, 8 + i] + c3 * S[r, 17 + i] + s3 * S[r, 26 + i]) * m[i]
        for i in range(r + 1, 8):
            v -= S[r, i] * x[i]
        x[r] = v / S[r, r] if S[r, r] != 0.0 else 0.0
    a[0], a[1], a[3], a[4], a[5] = math.atan2(x[5], x[2]), math.atan2(x[1], x[0]), a4, a5, 0.0
    J, e = np.empty((6, 6)), np.empty(6)
    _, a[5] = closing_error(K, a, J, e)
    return closing_error(K, a, J, e)[0]


@njit(**OPTIONS)
def _find(a: Array, cut: int, angles: Array, count: int) -> int:
    """Row of angles (16, 6) that equals a (6,), found with the chain cut at joint `cut`; else it is written to row count."""
    for k in range(count):
        largest = 0.0
        for i in range(6):
            turn = (a[i] - angles[k, (i + cut) % 6]) / (2 * math.pi)
            largest = max(largest, abs(turn - math.floor(turn + 0.5)))
        if largest * 2 * math.pi < SAME:
            return k
    if count < MAX_SOLUTIONS:
        for i in range(6):
            angles[count, (i + cut) % 6] = a[i]
    return count


@njit(**OPTIONS)
def solve_chain(K: Array, nearly_real: float, angles: Array) -> int:
    """All real a with L(a6) K6 ... L(a2) K2 L(a1) K1 = I, for rigid motions K (6, 3, 4), into angles (16, 6) rad.

    Complex pairs within nearly_real (rad) of a real root give the angles nearby that close the chain best; 0: none.
    Returns the number of solutions.
    """
    length = 0.0
    for k in range(6):
        length += math.sqrt(K[k, 0, 3] ** 2 + K[k, 1, 3] ** 2 + K[k, 2, 3] ** 2)
    if not 0.0 < length < math.inf:
        return 0
    C = np.empty((6, 3, 4))
    roots = np.empty((MAX_ROOTS, 2))
    a = np.empty(6)
    seen = np.zeros(MAX_SOLUTIONS, np.bool_)
    near = max(nearly_real, TORN)
    count = 0
    for cut in range(_CUTS):
        for k in range(6):
            for i in range(3):
                for j in range(3):
                    C[k, i, j] = K[(k + cut) % 6, i, j]
                C[k, i, 3] = K[(k + cut) % 6, i, 3] * (6.0 / length)
        left, right = axis_equations(C)
        S = reduce_equations(left, right)
        E = half_angle_forms(S)
        f = resultant(E)
        seen[:] = False
        lost = False
        for k in range(real_roots(f, near, roots)):
            a[2] = roots[k, 0]
            rough = _other_angles(C, S, E, a)
            error, ratio = close(C, a, 20, 1e-14)
            real = roots[k, 1] == 0.0
            lost = lost or (real and not rough < ROUGH)
            if (error < CLOSED and ratio > MOVABLE) or (not real and CLOSED < error < nearly_real):
                row = _find(a, cut, angles, count)
                if row == MAX_SOLUTIONS:
                    continue
                lost = lost or (real and seen[row])
                seen[row] = True
                count = max(count, row + 1)
            else:
                lost = lost or real
        if not lost and count + cut > 0:
            break
    return count
