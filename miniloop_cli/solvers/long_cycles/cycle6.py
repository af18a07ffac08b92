"""Six scans, 2+2+2+2+2+2 matches: six revolute axes in a ring, the inverse kinematics of a general 6R arm.

With T_e = G^-1 L(a_e) H for the five edges of the chain and for the closing one the ring is
G6^-1 L(a6) H6 = T5 T4 T3 T2 T1, that is

    L(-a6) (G6 G5^-1) L(a5) K5 L(a4) K4 L(a3) K3 L(a2) K2 L(a1) (H1 H6^-1) = I,   K_i = H_i G_{i-1}^-1.

12 matches, 36 equations less the six distances every rigid motion preserves, on 5 x 6 unknowns: finitely many
solutions, at most 16 (the paper counts 288), and no equation left to rank them.
"""

from __future__ import annotations

import math

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS, axis_frame, write_edge
from miniloop_cli.solvers.batch import run_batch, run_single
from miniloop_cli.solvers.long_cycles.six_revolute import EXACT, MAX_SOLUTIONS, set_link, solve_chain
from miniloop_cli.typing import Floats, Ints

MATCHES = (2, 2, 2, 2, 2, 2)


@njit(**OPTIONS, inline="always")
def solve_within(p: Floats, q: Floats, T: Floats, nearly_real: float) -> int:
    """Like `solve`; complex pairs within about `nearly_real` (rad) give poses near by that do not quite close."""
    K = np.empty((6, 3, 4))
    for e in range(6):
        # Scan e+1 is left by edge e and entered by the one before; the closing edge joins scan 1 (p) to scan 6 (q).
        H, good_h = axis_frame(p if e < 5 else q, 2 * e)
        G, good_g = axis_frame(q if e > 0 else p, (2 * e + 10) % 12)
        if not (good_h and good_g):
            return 0
        set_link(K, e, H, G)
    angles = np.empty((MAX_SOLUTIONS, 6))
    count = solve_chain(K, nearly_real, angles)
    for e in range(5):
        H, _ = axis_frame(p, 2 * e)
        G, _ = axis_frame(q, 2 * e)
        for s in range(count):
            write_edge(T, s, e, H, G, math.cos(angles[s, e]), math.sin(angles[s, e]))
    return count


@njit(**OPTIONS, inline="always")
def solve(p: Floats, q: Floats, T: Floats) -> int:
    """p, q (12, 3) matches of the edges 1-2 ... 5-6, 1-6, two each; T (16, 5, 3, 4) receives 1 -> 2 -> ... -> 6.

    Returns the number of solutions, 0 to 16.
    """
    return solve_within(p, q, T, EXACT)


@njit(**OPTIONS)
def _solve_all(p: Floats, q: Floats, T: Floats, counts: Ints, nearly_real: float) -> None:
    for i in range(p.shape[0]):
        counts[i] = solve_within(p[i], q[i], T[i], nearly_real)


def solve_batch(p: Floats, q: Floats, nearly_real: float = EXACT) -> tuple[Floats, Ints]:
    """Samples p, q (b, 12, 3) to solutions T (b, 16, 5, 3, 4) and counts (b,); `nearly_real` as in solve_within."""
    return run_batch(_solve_all, MATCHES, MAX_SOLUTIONS, p, q, nearly_real)


def cycle6(p: Floats, q: Floats, best: bool = False) -> Floats:
    """Solutions (s, 5, 4, 4) of scans 1 -> ... -> 6 from matches p, q (12, 3) of 1-2 ... 5-6, 1-6, two each.

    `best` keeps the one of least residual, which is an arbitrary one: no match is redundant, all solutions close alike.
    """
    return run_single(solve_batch, MATCHES, p, q, best)
