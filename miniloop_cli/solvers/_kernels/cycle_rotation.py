"""Reading a 5-cycle from another scan, which is possible as every edge has two matches.

The edges form a ring: edge e joins scan e to scan e+1 and edge 4, the closing one, scan 4 to scan 0.
"""

from __future__ import annotations

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS
from miniloop_cli.typing import Floats

EDGES = 5


@njit(**OPTIONS)
def rotated_matches(start: int, p: Floats, q: Floats, new_p: Floats, new_q: Floats) -> None:
    """Write the matches p, q (10, 3) in the order of the cycle that starts at scan `start` to new_p, new_q (10, 3)."""
    for edge in range(EDGES):
        old = (edge + start) % EDGES
        # Matches of a closing edge run from the first scan to the last, against the ring.
        against = (old == EDGES - 1) != (edge == EDGES - 1)
        for k in range(2):
            for axis in range(3):
                a, b = p[2 * old + k, axis], q[2 * old + k, axis]
                new_p[2 * edge + k, axis] = b if against else a
                new_q[2 * edge + k, axis] = a if against else b


@njit(**OPTIONS)
def poses_from_rotated(start: int, new_T: Floats, T: Floats, s: int) -> None:
    """Poses T[s] (4, 3, 4) of the chain from scan 0 from new_T[s] of the chain that starts at scan `start`, 1 to 4."""
    missing = start - 1
    for old in range(EDGES - 1):
        if old != missing:
            for row in range(3):
                for column in range(4):
                    T[s, old, row, column] = new_T[s, (old - start) % EDGES, row, column]
    # The edge that closes the new chain is its inverse: unit vectors and the origin, drawn back pose by pose.
    for column in range(4):
        x, y, z = 1.0 if column == 0 else 0.0, 1.0 if column == 1 else 0.0, 1.0 if column == 2 else 0.0
        for edge in range(EDGES - 2, -1, -1):
            A = new_T[s, edge]
            if column == 3:
                x, y, z = x - A[0, 3], y - A[1, 3], z - A[2, 3]
            x, y, z = (
                A[0, 0] * x + A[1, 0] * y + A[2, 0] * z,
                A[0, 1] * x + A[1, 1] * y + A[2, 1] * z,
                A[0, 2] * x + A[1, 2] * y + A[2, 2] * z,
            )
        T[s, missing, 0, column], T[s, missing, 1, column], T[s, missing, 2, column] = x, y, z
