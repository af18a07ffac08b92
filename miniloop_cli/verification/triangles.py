"""Triangles of edges: which edges close them, and which close few or none.

A true edge closes the triangles whose other two edges are true; a false one closes nearly none. The check is local and
therefore free of drift; it does not depend on the size of the graph.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging.voting import Near, agree, directed
from miniloop_cli.geometry.pose_rows import compose, invert, load
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.scene.view_graph import adjacency
from miniloop_cli.typing import Bools, Floats, Ints

MAX_TRIANGLES = 64  # triangles of an edge that are checked
MIN_CLOSED_TRIANGLES = 2  # triangles that make an edge sure, and sure edges that make a scan's others dispensable
CHANCE_RATIO = 6  # one triangle in so many closes by chance; for true edges one in four, with half of all edges false
ROUNDS = 8


def doubtful(count: int, pairs: Ints, T_j_i: Floats, near: Near) -> Bools:
    """Edges (m,) bool that close none or few of their triangles, between scans that have sure edges.

    Rows (m, 7) and `near` as in voting.py; pairs (m, 2) all different. Doubtful edges are removed with their triangles,
    and the check is repeated. Edges that lie on fewer than MIN_CLOSED_TRIANGLES triangles are not doubted.
    """
    out = np.zeros(len(pairs), bool)
    rows = adjacency(count, pairs)
    for _ in range(ROUNDS):
        closed, asked = _triangles(pairs, T_j_i, *rows, out, near)
        sure = np.bincount(pairs[closed >= MIN_CLOSED_TRIANGLES].ravel(), minlength=count) >= MIN_CLOSED_TRIANGLES
        more = ~out & (asked >= MIN_CLOSED_TRIANGLES) & (closed <= asked // CHANCE_RATIO) & sure[pairs].all(axis=1)
        if not more.any():
            break
        out |= more
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _triangles(
    pairs: Ints, T_j_i: Floats, start: Ints, neighbour: Ints, edge: Ints, out: Bools, near: Near
) -> tuple[Ints, Ints]:
    """Numbers of closed triangles and of all triangles of every edge (m,), without those that have a removed edge."""
    closed, asked = np.zeros(len(pairs), np.int64), np.zeros(len(pairs), np.int64)
    for e in range(len(pairs)):
        if out[e]:
            continue
        i, j = pairs[e, 0], pairs[e, 1]
        a, b = start[i], start[j]
        while a < start[i + 1] and b < start[j + 1] and asked[e] < MAX_TRIANGLES:
            if neighbour[a] < neighbour[b]:
                a += 1
            elif neighbour[a] > neighbour[b]:
                b += 1
            else:
                if not (out[edge[a]] or out[edge[b]]):
                    around = compose(invert(directed(T_j_i, pairs, edge[b], j)), directed(T_j_i, pairs, edge[a], i))
                    closed[e] += agree(load(T_j_i, e), around, near)
                    asked[e] += 1
                a += 1
                b += 1
    return closed, asked
