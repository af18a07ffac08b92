"""Where rotation averaging starts: a spanning tree of the edges with the most support."""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging import kernels
from miniloop_cli.averaging.graph import Floats, Ints, adjacency

UNCHECKED_RAD = np.radians(20.0)
"""Assumed error of an edge in no triangle: between one that contradicts its triangles and a confirmed one."""

BETAS = (0.0, 2.0, 5.0, 12.0, 30.0)
"""Annealing of the message passing, 1/rad: first every triangle counts, in the end those of good edges."""


def loop_errors(count: int, pairs: Ints, q_j_i: Floats, weights: Floats) -> Floats:
    """Error (m,) of every edge, rad, as its triangles tell: small where they close, large where this edge is wrong.

    Cycle-edge message passing (Lerman & Shi, "Robust group synchronization via cycle-edge message passing", 2022).
    """
    rows = adjacency(count, pairs)
    error = np.zeros(len(pairs))
    for beta in BETAS:
        error = kernels.loop_error(pairs, q_j_i, weights, *rows, error, beta)
        error[np.isnan(error)] = UNCHECKED_RAD
    return error


def tree_start(count: int, pairs: Ints, q_j_i: Floats, support: Floats) -> Floats:
    """Rotations (n, 4) along the spanning tree of maximum support, from the scan with the most of it."""
    tree = kernels.kruskal(count, pairs, np.argsort(-support, kind="stable"))
    start, neighbour, edge = adjacency(count, pairs[tree])
    i, j = pairs.T
    root = int(np.argmax(np.bincount(i, support, count) + np.bincount(j, support, count)))
    order, via = kernels.breadth_first(start, neighbour, tree[edge] if len(tree) else edge, root)
    return kernels.chain(pairs, q_j_i, order, via)
