"""Six scans, 2+2+2+2+2+2 matches: six revolute axes in a ring, the inverse kinematics of a general 6R arm.

With T_e = G^-1 L(a_e) H for the five edges of the chain and for the closing one the ring is
G6^-1 L(a6) H6 = T5 T4 T3 T2 T1, that is

    L(-a6) (G6 G5^-1) L(a5) K5 L(a4) K4 L(a3) K3 L(a2) K2 L(a1) (H1 H6^-1) = I,   K_i = H_i G_{i-1}^-1.

12 matches, 36 equations less the six distances every rigid motion preserves, on 5 x 6 unknowns: finitely many solutions,
at most 16 (the paper counts 288), and no equation left to rank them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from miniloop_cli.solvers.alignment import OPTIONS, Array, axis_frame, write_edge
from miniloop_cli.solvers.six_revolute import MAX_SOLUTIONS, set_link, solve_chain

MATCHES = (2, 2, 2, 2, 2, 2)


@njit(**OPTIONS)
def solve_within(p: Array, q: Array, T: Array, nearly_real: float) -> int:
    """Like `solve`; complex pairs within about `nearly_real` (rad) give the nearest real poses, 0: none."""
    K = np.empty((6, 3, 4))
    for e in range(6):
        # A scan is entered by the edge before and left by edge e; the closing edge joins scan 1 (p) to scan 6 (q).
        if e == 0:
            leave, good_leave = axis_frame(p, 0)
            enter, good_enter = axis_frame(p, 10)
        elif e == 5:
            leave, good_leave = axis_frame(q, 10)
            enter, good_enter = axis_frame(q, 8)
        else:
            leave, good_leave = axis_frame(p, 2 * e)
            enter, good_enter = axis_frame(q, 2 * e - 2)
        if not (good_leave and good_enter):
            return 0
        set_link(K, e, leave, enter)
    angles = np.empty((MAX_SOLUTIONS, 6))
    count = solve_chain(K, nearly_real, angles)
    for e in range(5):
        H, _ = axis_frame(p, 2 * e)
        G, _ = axis_frame(q, 2 * e)
        for s in range(count):
            write_edge(T, s, e, H, G, math.cos(angles[s, e]), math.sin(angles[s, e]))
    return count


@njit(**OPTIONS)
def solve(p: Array, q: Array, T: Array) -> int:
    """p, q (12, 3) matches of the edges 1-2 ... 5-6 and 1-6, two each; T (16, 5, 3, 4) receives 1 -> 2 -> ... -> 6.

    Returns the number of solutions, 0 to 16.
    """
    return solve_within(p, q, T, 0.0)
