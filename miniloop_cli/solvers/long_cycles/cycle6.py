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

from miniloop_cli.solvers._kernels.alignment import edge_frames, write_edge
from miniloop_cli.solvers.batch import minimal_solver
from miniloop_cli.solvers.long_cycles.six_revolute import EXACT, MAX_SOLUTIONS, set_link, solve_chain
from miniloop_cli.typing import Floats


@minimal_solver(matches=(2, 2, 2, 2, 2, 2), solutions=MAX_SOLUTIONS, nearly_real=EXACT)
def cycle6(p: Floats, q: Floats, T: Floats, nearly_real: float) -> int:
    """p, q (12, 3) matches of the edges 1-2 ... 5-6, 1-6, two each; T (16, 5, 3, 4) receives 1 -> 2 -> ... -> 6.

    Returns the number of solutions, 0 to 16. Complex pairs within about `nearly_real` (rad) give poses near by that do
    not quite close.
    """
    H, G = np.empty((6, 12)), np.empty((6, 12))
    if not edge_frames(p, q, H, G):
        return 0
    K = np.empty((6, 3, 4))
    # Scan e+1 is left by edge e and entered by the one before; the closing edge joins scan 1 (H) to scan 6 (G).
    for e in range(1, 5):
        set_link(K, e, H[e], G[e - 1])
    set_link(K, np.int64(0), H[0], H[5])
    set_link(K, np.int64(5), G[5], G[4])
    angles = np.empty((MAX_SOLUTIONS, 6))
    count = solve_chain(K, nearly_real, angles)
    for e in range(5):
        for s in range(count):
            write_edge(T[s, e], H[e], G[e], math.cos(angles[s, e]), math.sin(angles[s, e]))
    return count
