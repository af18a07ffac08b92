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
from miniloop_cli.solvers import pairwise
from miniloop_cli.solvers._kernels.alignment import OPTIONS, Motion, axis_frame, write_edge
from miniloop_cli.solvers.batch import run_batch, run_single
from miniloop_cli.solvers.long_cycles.six_revolute import EXACT, MAX_SOLUTIONS, set_link, solve_chain
from miniloop_cli.typing import Floats, Ints

MATCHES = (2, 2, 2, 2, 2, 2, 3)


@njit(**OPTIONS)
def _seen_from_before(G: Motion, C: Floats) -> Motion:
    """The frame G C in scan 1, for a frame G in scan 7 and C (3, 4) from scan 1 to scan 7."""
    x, y, z = G[9] - C[0, 3], G[10] - C[1, 3], G[11] - C[2, 3]
    return (
        G[0] * C[0, 0] + G[1] * C[1, 0] + G[2] * C[2, 0],
        G[0] * C[0, 1] + G[1] * C[1, 1] + G[2] * C[2, 1],
        G[0] * C[0, 2] + G[1] * C[1, 2] + G[2] * C[2, 2],
        G[3] * C[0, 0] + G[4] * C[1, 0] + G[5] * C[2, 0],
        G[3] * C[0, 1] + G[4] * C[1, 1] + G[5] * C[2, 1],
        G[3] * C[0, 2] + G[4] * C[1, 2] + G[5] * C[2, 2],
        G[6] * C[0, 0] + G[7] * C[1, 0] + G[8] * C[2, 0],
        G[6] * C[0, 1] + G[7] * C[1, 1] + G[8] * C[2, 1],
        G[6] * C[0, 2] + G[7] * C[1, 2] + G[8] * C[2, 2],
        C[0, 0] * x + C[1, 0] * y + C[2, 0] * z,
        C[0, 1] * x + C[1, 1] * y + C[2, 1] * z,
        C[0, 2] * x + C[1, 2] * y + C[2, 2] * z,
    )


@njit(**OPTIONS, inline="always")
def solve_within(p: Floats, q: Floats, T: Floats, nearly_real: float) -> int:
    """Like `solve`; complex pairs within about `nearly_real` (rad) give poses near by that do not quite close."""
    closing = np.empty((1, 1, 3, 4))
    if pairwise.solve(p[12:], q[12:], closing) == 0:
        return 0
    K = np.empty((6, 3, 4))
    for e in range(6):
        H, good_h = axis_frame(p, 2 * e)
        G, good_g = axis_frame(q, (2 * e + 10) % 12)
        if not (good_h and good_g):
            return 0
        # Scan 1 is entered, as it were, by the last edge of the chain, carried back through the closing pose.
        set_link(K, e, H, _seen_from_before(G, closing[0, 0]) if e == 0 else G)
    angles = np.empty((MAX_SOLUTIONS, 6))
    count = solve_chain(K, nearly_real, angles)
    for e in range(6):
        H, _ = axis_frame(p, 2 * e)
        G, _ = axis_frame(q, 2 * e)
        for s in range(count):
            write_edge(T, s, e, H, G, math.cos(angles[s, e]), math.sin(angles[s, e]))
    return count


@njit(**OPTIONS, inline="always")
def solve(p: Floats, q: Floats, T: Floats) -> int:
    """p, q (15, 3) matches of the edges 1-2 ... 6-7, two each, and three of 1-7; returns the number of solutions.

    T (16, 6, 3, 4) receives 1 -> 2 -> ... -> 7.
    """
    return solve_within(p, q, T, EXACT)


@njit(**OPTIONS)
def _solve_all(p: Floats, q: Floats, T: Floats, counts: Ints, nearly_real: float) -> None:
    for i in range(p.shape[0]):
        counts[i] = solve_within(p[i], q[i], T[i], nearly_real)


def solve_batch(p: Floats, q: Floats, nearly_real: float = EXACT) -> tuple[Floats, Ints]:
    """Samples p, q (b, 15, 3) to solutions T (b, 16, 6, 3, 4) and counts (b,); `nearly_real` as in solve_within."""
    return run_batch(_solve_all, MATCHES, MAX_SOLUTIONS, p, q, nearly_real)


def cycle7(p: Floats, q: Floats, best: bool = False) -> Floats:
    """Solutions (s, 6, 4, 4) of scans 1 -> ... -> 7 from p, q (15, 3), two matches each of 1-2 ... 6-7, three of 1-7.

    `best` keeps the one of least residual, which is an arbitrary one: no match is redundant, all solutions close alike.
    """
    return run_single(solve_batch, MATCHES, p, q, best)
