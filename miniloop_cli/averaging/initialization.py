"""The start of rotation averaging: robust by votes, or along a spanning tree."""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging import voting
from miniloop_cli.geometry.quaternion_kernels import chain
from miniloop_cli.runtime.blocks import ONE_THREAD, Blocks
from miniloop_cli.scene.view_graph import adjacency
from miniloop_cli.typing import Floats, Ints

CONFIRMED = 0.7
"""Votes that place a scan at once: one edge whose triangle closes has 3/4, two agreeing edges in no triangle have 1."""

SWEEPS = 8


def trust(weights: Floats) -> Floats:
    """Votes (m,) of edges from their positive weights: 1 for the median, half to one and a half."""
    return np.clip(np.sqrt(weights / np.median(weights)), 0.5, 1.5)


def voted_start(
    count: int,
    pairs: Ints,
    T_j_i: Floats,
    votes: Floats,
    near: tuple[float, float],
    blocks: Blocks = ONE_THREAD,
) -> Floats:
    """Poses (n, 7) that most edges of every scan agree with; hierarchical. Poses and `near` as in voting.py.

    Clusters grow from scan to scan while the votes are sure. Then the clusters are the scans of a smaller graph, in
    which all edges between two clusters vote together, and so on. If no votes are sure (random graphs have no short
    loops), scans are placed by the available edges, and votes among all placed scans then correct wrong ones.
    pairs (m, 2), T_j_i (m, 7), `votes` (m,) of the edges, about 1 for an ordinary one; the graph is connected. The
    threads of `blocks` share the checks of loops.
    """
    rows = adjacency(count, pairs)
    i, j = pairs.T
    checked = np.empty(len(pairs))
    blocks.map(voting.loop_votes, len(pairs), pairs, T_j_i, votes, *rows, near, checked)
    voters = max(48, 2**20 // max(len(pairs), 1))
    seeds = np.argsort(-(np.bincount(i, checked, count) + np.bincount(j, checked, count)), kind="stable")
    T, cluster, order = voting.grow(pairs, T_j_i, checked, *rows, seeds, near, CONFIRMED, voters)
    clusters = int(cluster.max()) + 1
    if clusters > 0.8 * count:
        T, _, order = voting.grow(pairs, T_j_i, checked, *rows, seeds, near, 0.0, voters)
    elif clusters > 1:
        across = cluster[i] != cluster[j]
        T_between = voting.between(T, pairs[across], T_j_i[across])
        T_cluster = voted_start(clusters, cluster[pairs[across]], T_between, votes[across], near, blocks)
        voting.move(T, cluster, T_cluster)
    for _ in range(SWEEPS):
        if voting.vote_again(T, pairs, T_j_i, votes, *rows, order, near, voters) <= count // 1000:
            break
    return T


def tree_start(count: int, pairs: Ints, q_j_i: Floats, weights: Floats) -> Floats:
    """Rotations (n, 4) along the spanning tree of maximum weight, from the scan with the most of it.

    pairs (m, 2), quaternions q_j_i (m, 4) as in geometry/quaternion_kernels.py, weights (m,).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

    by_weight = np.argsort(-weights, kind="stable")
    code = np.sort(pairs, axis=1) @ [count, 1]
    rank = np.sort(np.unique(code[by_weight], return_index=True)[1])  # the heaviest of several edges of a pair
    i, j = pairs[by_weight[rank]].T
    ends = (i.astype(np.int32), j.astype(np.int32))  # scipy 1.15 supports no other type here
    tree = minimum_spanning_tree(coo_array((rank + 1.0, ends), shape=(count, count)).tocsr()).tocoo()
    edge = by_weight[tree.data.astype(np.int64) - 1]
    i, j = pairs.T
    root = int(np.argmax(np.bincount(i, weights, count) + np.bincount(j, weights, count)))
    order, before = breadth_first_order(tree.tocsr(), root, directed=False)
    via = np.full(count, -1)
    child = np.where(before[i[edge]] == j[edge], i[edge], j[edge])
    via[child] = edge
    return chain(pairs, q_j_i, order.astype(np.int64), via)
