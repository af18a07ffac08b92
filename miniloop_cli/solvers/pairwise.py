"""Two scans, three matches (paper, sec. 2.2): two of them give the axis, the third the angle about it.

In the aligned frames q = L(a) p is, seen as complex numbers x + iy, q = e^{ia} p: two linear equations in
(cos a, sin a) whose least-squares solution on the circle is conj(p) q / |p q|. One solution; the paper solves one
of the two equations with the circle and gets two, of which one is an artefact.
The axis is the longest side of the triangle: the order of the matches does not matter, and a long baseline
is a better axis. Filtered: coincident points, a third match on the axis.
"""

from __future__ import annotations

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS, aligned, frame_through, off_axis, unit, write_edge
from miniloop_cli.solvers.batch import run_batch, run_single
from miniloop_cli.typing import Floats, Ints

MATCHES = (3,)
MAX_SOLUTIONS = 1


@njit(**OPTIONS)
def _third(p: Floats) -> int:
    """The corner of the triangle p (3, 3) that lies opposite its longest side."""
    a, b, c = 0.0, 0.0, 0.0
    for k in range(3):
        a += (p[1, k] - p[2, k]) ** 2
        b += (p[2, k] - p[0, k]) ** 2
        c += (p[0, k] - p[1, k]) ** 2
    return 0 if a >= b and a >= c else 1 if b >= c else 2


@njit(**OPTIONS)
def solve(p: Floats, q: Floats, T: Floats) -> int:
    """p, q (3, 3) matches of scan 1 and scan 2; T (1, 1, 3, 4) receives scan 1 -> scan 2; returns 0 or 1."""
    k = _third(p)
    i, j = (k + 1) % 3, (k + 2) % 3
    H, good_h = frame_through(p, i, j)
    G, good_g = frame_through(q, i, j)
    a, b = aligned(H, p, k), aligned(G, q, k)
    turn, good = unit(complex(a[0], -a[1]) * complex(b[0], b[1]))
    if not (good_h and good_g and off_axis(H, a) and off_axis(G, b) and good):
        return 0
    write_edge(T, 0, 0, H, G, turn.real, turn.imag)
    return 1


@njit(**OPTIONS)
def _solve_all(p: Floats, q: Floats, T: Floats, counts: Ints) -> None:
    for i in range(p.shape[0]):
        counts[i] = solve(p[i], q[i], T[i])


def solve_batch(p: Floats, q: Floats) -> tuple[Floats, Ints]:
    """Samples p, q (b, 3, 3) to solutions T (b, 1, 1, 3, 4) and counts (b,), one thread."""
    return run_batch(_solve_all, MATCHES, MAX_SOLUTIONS, p, q)


def pairwise(p: Floats, q: Floats, best: bool = False) -> Floats:
    """Scan 1 -> scan 2 as (1, 1, 4, 4), or (0, 1, 4, 4), from matches p, q (3, 3)."""
    return run_single(solve_batch, MATCHES, p, q, best)
