"""A 5-cycle has no first scan: with two matches on every edge it can be read from any of its scans.

The edges form a ring: edge e joins scan e to scan e+1 and edge 4, the closing one, scan 4 to scan 0.
"""

from __future__ import annotations

from numba import njit

from miniloop_cli.solvers.alignment import OPTIONS, Array

EDGES = 5


@njit(**OPTIONS)
def read_from(start: int, p: Array, q: Array, new_p: Array, new_q: Array) -> None:
    """The matches p, q (10, 3) in the order and direction in which a cycle starting at scan `start` has them."""
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
def write_back(start: int, new_T: Array, T: Array) -> None:
    """Poses T (4, 3, 4) of the chain from scan 0 from those of the chain that starts at scan `start`, 1 to 4."""
    for old in range(EDGES - 1):
        edge = (old - start) % EDGES
        if edge < EDGES - 1:
            T[old] = new_T[edge]
    # The edge that closes the new chain is its inverse.
    missing = T[start - 1]
    missing[:] = new_T[0]
    for edge in range(1, EDGES - 1):
        A = new_T[edge]
        for column in range(4):
            x, y, z = missing[0, column], missing[1, column], missing[2, column]
            for row in range(3):
                shift = A[row, 3] if column == 3 else 0.0
                missing[row, column] = A[row, 0] * x + A[row, 1] * y + A[row, 2] * z + shift
    for row in range(3):
        for column in range(row):
            missing[row, column], missing[column, row] = missing[column, row], missing[row, column]
    x, y, z = missing[0, 3], missing[1, 3], missing[2, 3]
    for row in range(3):
        missing[row, 3] = -(missing[row, 0] * x + missing[row, 1] * y + missing[row, 2] * z)
