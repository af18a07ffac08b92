"""Inverse kinematics of a general chain of six revolute joints: all real solutions, at most 16.

1. The fourteen equations are reduced to six in three angles (six_revolute_equations).
2. Their resultant is a trigonometric polynomial of degree 8 in the third angle (six_revolute_resultant).
3. Its real roots are isolated by Descartes' rule (six_revolute_roots); each gives the other angles by linear algebra.
4. Newton's method on the closing error (six_revolute_closure) removes the rounding errors of 1-3; what does not close,
   coincides with another solution or can move (a degenerate chain) is dropped.
5. Where a real root is lost or may be, the chain is cut at the next joint, so that another angle is hidden in the
   resultant, and the solutions are united. If no cut works, as in a ring whose neighbouring axes all meet, the
   roots of a chain nearby serve as starting points for Newton's method.

Sources: Raghavan & Roth, "Inverse kinematics of the general 6R manipulator and related linkages", 1993; for the
numerical view Manocha & Canny, "Efficient inverse kinematics for general 6R manipulators", 1994.
"""

from __future__ import annotations

import math

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS, joint
from miniloop_cli.solvers.long_cycles.six_revolute_closure import close, closing_error
from miniloop_cli.solvers.long_cycles.six_revolute_equations import axis_equations, reduce_equations, well_posed
from miniloop_cli.solvers.long_cycles.six_revolute_resultant import angles_at, half_angle_forms, resultant
from miniloop_cli.solvers.long_cycles.six_revolute_roots import MAX_ROOTS, real_roots
from miniloop_cli.typing import Floats

MAX_SOLUTIONS = 16
# Value of `nearly_real` with which every solution closes the chain.
EXACT = 0.0
# The closing error (rad, and in units of the mean link length) over the ratio of pivots of its derivative measures how
# well the angles are determined. Above this the chain can move or solutions coincide, as with axes in one plane.
DETERMINED = 1e-8
NEWTON_STEPS = 20
# Closing error before Newton's method above which rounding may hide other roots.
ROUGH = 1e-6
# Closing error before Newton's method above which a root is discarded.
HOPELESS = 0.1
# Rounding splits double roots into complex pairs with at most this imaginary part (rad).
TORN = 1e-3
# Two solutions all of whose angles (rad) agree to this are one.
SAME = 1e-6
# Largest determinant of the scaled equations below which it is zero but for rounding (1e-5 in the median).
VANISHING = 1e-18
# Where no cut is sound (all neighbouring axes meet), the links are moved so far to find starts for Newton's method.
NUDGE = 1e-3
_NUDGE = np.cos(np.arange(30.0) ** 2).reshape(6, 5)


@njit(**OPTIONS)
def set_link(K: Floats, e: int, H: Floats, G: Floats) -> None:
    """K[e] of (6, 3, 4) = H G^-1: the link entered through the axis of frame G and left through that of H."""
    k = joint(H, G)
    for i in range(3):
        for j in range(3):
            K[e, i, j] = k[3 * i + j]
        K[e, i, 3] = k[9 + i]


@njit(**OPTIONS)
def _other_angles(K: Floats, S: Floats, E: Floats, a: Floats) -> float:
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
def _find(a: Floats, cut: int, angles: Floats, count: int) -> int:
    """Row of angles (16, 6) that equals a (6,), found with the chain cut at joint `cut`; a becomes a row if none does.

    Returns MAX_SOLUTIONS if there is no room.
    """
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
def _cut_chain(K: Floats, scale: float, cut: int, nudge: float, C: Floats) -> None:
    """C (6, 3, 4): the chain K renumbered from joint `cut` on, lengths scaled, every link moved by about `nudge`."""
    for k in range(6):
        link = K[(k + cut) % 6]
        for j in range(4):
            for i in range(3):
                C[k, i, j] = link[i, j] * (scale if j == 3 else 1.0)
        if nudge > 0.0:
            for i in range(2):  # turn rows i and 2
                x = nudge * _NUDGE[k, i]
                c, s = math.cos(x), math.sin(x)
                for j in range(4):
                    C[k, i, j], C[k, 2, j] = c * C[k, i, j] - s * C[k, 2, j], s * C[k, i, j] + c * C[k, 2, j]
            for i in range(3):
                C[k, i, 3] += nudge * _NUDGE[k, 2 + i]


@njit(**OPTIONS)
def _solve_cut(C: Floats, D: Floats, cut: int, nearly_real: float, angles: Floats, count: int) -> tuple[int, bool]:
    """Unite the solutions of the chain C, cut at joint `cut`, with the first `count` rows of angles (16, 6).

    The roots come from the chain D, which is C or near it. Returns the new count, and whether the cut was sound: the
    equations regular, no root lost, and no root so inaccurate that rounding may hide others.
    """
    left, right = axis_equations(D)
    S = reduce_equations(left, right)
    E = half_angle_forms(S)
    largest, f = resultant(E)
    if not (largest > VANISHING and well_posed(S)):
        return count, False
    roots = np.empty((MAX_ROOTS, 2))
    seen = np.zeros(MAX_SOLUTIONS + 1, np.bool_)
    a = np.empty(6)
    sound = True
    for k in range(real_roots(f, max(nearly_real, TORN), roots)):
        real = roots[k, 1] == 0.0
        a[2] = roots[k, 0]
        rough = _other_angles(D, S, E, a)
        if rough > HOPELESS:
            sound = sound and not real
            continue
        error, ratio = close(C, a, NEWTON_STEPS, 1e-14)
        closed = error < DETERMINED * ratio
        if closed or (not real and DETERMINED < error < nearly_real):
            row = _find(a, cut, angles, count)
            sound = sound and not (real and seen[row]) and not (closed and rough > ROUGH)
            seen[row] = True
            count = min(max(count, row + 1), MAX_SOLUTIONS)
        else:
            sound = sound and not real
    return count, sound


@njit(**OPTIONS, inline="always")
def solve_chain(K: Floats, nearly_real: float, angles: Floats) -> int:
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
    D = np.empty((6, 3, 4))
    count, cuts = np.int64(0), np.int64(0)  # a literal 0 would compile _solve_cut a second time
    for attempt in range(9):
        if attempt == 6 and cuts > 0 and count > 0:
            break
        cut = attempt % 6
        _cut_chain(K, 6.0 / length, cut, 0.0, C)
        _cut_chain(K, 6.0 / length, cut, NUDGE if attempt >= 6 else 0.0, D)
        count, sound = _solve_cut(C, D, cut, nearly_real, angles, count)
        cuts += sound and attempt < 6
        # Solutions come in pairs, and chains without any are rare: if there are none, a second cut has to agree.
        if cuts > (0 if count > 0 and count % 2 == 0 else 1):
            break
    return int(count)
