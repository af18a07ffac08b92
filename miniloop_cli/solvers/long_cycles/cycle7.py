"""Seven scans, 2+2+2+2+2+2+3 matches: the inverse kinematics of a general 6R arm whose hand has a known pose.

The three closing matches give C, scan 1 -> scan 7. With T_e = G^-1 L(a_e) H for the six edges of the chain,
C = T6 ... T1 is

    L(a6) K6 L(a5) K5 L(a4) K4 L(a3) K3 L(a2) K2 L(a1) (H1 C^-1 G6^-1) = I,   K_i = H_i G_{i-1}^-1.

15 matches, 45 equations less the nine distances every rigid motion preserves, on 6 x 6 unknowns: at most 16 solutions
and no equation left to rank them.
"""

from __future__ import annotations

import math

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS, edge_frames, write_edge
from miniloop_cli.solvers.batch import minimal_solver
from miniloop_cli.solvers.long_cycles.six_revolute import EXACT, MAX_SOLUTIONS, set_link, solve_chain
from miniloop_cli.solvers.pairwise import pairwise
from miniloop_cli.typing import Floats

find_closing = pairwise.solve


@njit(**OPTIONS)
def _seen_from_before(G: Floats, C: Floats, seen: Floats) -> None:
    """The frame G C (12,) in scan 1, for a frame G (12,) in scan 7 and C (3, 4) from scan 1 to scan 7."""
    x, y, z = G[9] - C[0, 3], G[10] - C[1, 3], G[11] - C[2, 3]
    for j in range(3):
        for i in range(3):
            seen[3 * i + j] = G[3 * i] * C[0, j] + G[3 * i + 1] * C[1, j] + G[3 * i + 2] * C[2, j]
        seen[9 + j] = C[0, j] * x + C[1, j] * y + C[2, j] * z


@minimal_solver(matches=(2, 2, 2, 2, 2, 2, 3), solutions=MAX_SOLUTIONS, nearly_real=EXACT)
def cycle7(p: Floats, q: Floats, T: Floats, nearly_real: float) -> int:
    """p, q (15, 3) matches of the edges 1-2 ... 6-7, two each, and three of 1-7; returns the number of solutions.

    T (16, 6, 3, 4) receives 1 -> 2 -> ... -> 7. Complex pairs within about `nearly_real` (rad) give poses near by that
    do not quite close.
    """
    closing, H, G, entered = np.empty((1, 1, 3, 4)), np.empty((6, 12)), np.empty((6, 12)), np.empty(12)
    if find_closing(p[12:], q[12:], closing) == 0 or not edge_frames(p, q, H, G):
        return 0
    K = np.empty((6, 3, 4))
    # The last edge of the chain, mapped through the closing pose, gives the axis by which scan 1 is entered.
    _seen_from_before(G[5], closing[0, 0], entered)
    for e in range(6):
        set_link(K, e, H[e], G[e - 1] if e else entered)
    angles = np.empty((MAX_SOLUTIONS, 6))
    count = solve_chain(K, nearly_real, angles)
    for e in range(6):
        for s in range(count):
            write_edge(T[s, e], H[e], G[e], math.cos(angles[s, e]), math.sin(angles[s, e]))
    return count
