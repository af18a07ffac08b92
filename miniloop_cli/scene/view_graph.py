"""The view graph as arrays: checks, connected components, adjacency."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.scene.registration import RegistrationError
from miniloop_cli.typing import Floats, Ints


class GraphError(RegistrationError):
    """The view graph cannot be averaged: it is not connected, or has impossible edges."""


def components(count: int, pairs: ArrayLike) -> Ints:
    """Label (count,) of each scan's connected component; 0 is the component of the most scans, then by size.

    `pairs` (m, 2): the edges. Components of one size keep the order of their first scans.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if count < 1:
        return np.zeros(0, dtype=np.int64)
    i, j = checked_pairs(count, pairs).T
    ones = np.ones(len(i), dtype=np.int8)
    found, labels = connected_components(coo_array((ones, (i, j)), shape=(count, count)), directed=False)
    sizes = np.bincount(labels, minlength=found)
    first = np.full(found, count)
    np.minimum.at(first, labels, np.arange(count))
    rank = np.empty(found, dtype=np.int64)
    rank[np.lexsort((first, -sizes))] = np.arange(found)
    return rank[labels]


def bridges(pairs: Ints, piece: Ints) -> Ints:
    """Which of the edges (m, 2) between scans lie on no loop, given pieces (n,) that other edges join."""
    ends = np.sort(piece[pairs], axis=1)
    across = np.flatnonzero(ends[:, 0] != ends[:, 1])
    if not len(across):
        return across
    import networkx as nx  # imported here, as most recordings are one piece and do not need it

    joins, which, times = np.unique(ends[across], axis=0, return_inverse=True, return_counts=True)
    found = set(map(frozenset, nx.bridges(nx.Graph(joins.tolist()))))
    alone = [times[k] == 1 and frozenset(joins[k].tolist()) in found for k in which.ravel()]
    return across[alone]


def checked_pairs(count: int, pairs: ArrayLike) -> Ints:
    """`pairs` as (m, 2) int64; raises GraphError unless every edge joins two different scans of 0..count-1."""
    pairs = np.ascontiguousarray(np.asarray(pairs, dtype=np.int64).reshape(-1, 2))
    wrong = (pairs < 0).any(1) | (pairs >= count).any(1) | (pairs[:, 0] == pairs[:, 1])
    if wrong.any():
        e = int(np.flatnonzero(wrong)[0])
        raise GraphError(f"edge {e} joins {pairs[e, 0]} and {pairs[e, 1]}; need two different scans of 0..{count - 1}")
    return pairs


def checked_weights(weights: ArrayLike | None, edges: int) -> Floats:
    """Edge weights (m,), the largest 1; None: all 1. Raises GraphError for wrong shapes, signs or values."""
    if weights is None:
        return np.ones(edges)
    weights = np.array(weights, dtype=np.float64)
    if weights.shape != (edges,):
        raise GraphError(f"{edges} edges need weights of shape ({edges},), got {weights.shape}")
    wrong = ~(np.isfinite(weights) & (weights >= 0))
    if wrong.any():
        e = int(np.flatnonzero(wrong)[0])
        raise GraphError(f"edge {e} has weight {weights[e]}; weights must be finite and not negative")
    return weights / weights.max(initial=0.0) if weights.any() else weights


def require_connected(count: int, pairs: Ints) -> None:
    """Raise GraphError unless edges pairs (m, 2) connect all of the `count` >= 1 scans."""
    if count < 1:
        raise GraphError("there is no scan to average; at least one is needed")
    labels = components(count, pairs)
    if labels.max() > 0:
        lone = int(np.flatnonzero(labels)[0])
        raise GraphError(
            f"the view graph has {labels.max() + 1} components (scan {lone} is not connected to the largest); "
            "average each component on its own"
        )


def adjacency(count: int, pairs: Ints) -> tuple[Ints, Ints, Ints]:
    """Neighbours as compressed rows: `start` (count+1,), `neighbour` (2m,) ascending in each row, `edge` (2m,)."""
    edges = len(pairs)
    here, there = np.concatenate([pairs[:, 0], pairs[:, 1]]), np.concatenate([pairs[:, 1], pairs[:, 0]])
    order = np.argsort(here * count + there, kind="stable")
    start = np.zeros(count + 1, dtype=np.int64)
    np.cumsum(np.bincount(here, minlength=count), out=start[1:])
    return start, there[order], order % max(edges, 1)


def elimination_order(count: int, pairs: Ints) -> Ints:
    """Scans (count,) in an order that keeps factors of matrices with this graph sparse.

    pairs (m, 2): the edges.
    """
    return elimination(count, pairs)[0]


def elimination(count: int, pairs: Ints) -> tuple[Ints, float]:
    """The order (n,) of elimination by multiple minimum degree, and the multiplications that its factor takes.

    pairs (m, 2): the edges between `count` scans.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import splu

    here, there = np.concatenate([pairs, pairs[:, ::-1]]).T
    graph = coo_array((np.full(len(here), -1.0), (here, there)), shape=(count, count))
    own = coo_array((np.full(count, 2.0 * len(here) + 1), (np.arange(count), np.arange(count))), shape=(count, count))
    options = {"SymmetricMode": True}
    lu = splu((graph + own).tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return np.argsort(lu.perm_c), float((np.diff(lu.L.tocsc().indptr).astype(float) ** 2).sum() / 2)
