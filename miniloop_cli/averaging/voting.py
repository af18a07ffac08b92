"""A robust start for averaging: scans are placed one after another, each where most of its edges agree.

A spanning tree uses one edge a scan, and one false edge moves the whole subtree. Here each edge to a placed scan
proposes a pose, and similar proposals support each other. The scan with the best supported proposal is placed next, at
the mean of the agreeing ones. Later votes, with all scans placed, correct scans that were placed by a single false
edge.

Poses are rows (7,) as in geometry/pose_rows.py; `near` = (cosine of half an angle, squared distance) bounds the
difference of agreeing poses. Edges are `pairs` (m, 2) with `T_j_i` (m, 7) and the vote `trust` (m,) of each. Those at
a scan v are `neighbour` and `edge` (2 m,) from `start`[v] to `start`[v + 1], as `view_graph.adjacency` gives them.
Rotations alone: translations zero. Translations alone, in the world frame: rotations the identity.
"""

from __future__ import annotations

import math

import numpy as np

from miniloop_cli.geometry.pose_rows import Row, compose, invert, load, store
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats, Ints

Near = tuple[float, float]

LEVELS = 8
"""Supports within a factor of two share a level, a first-in, first-out queue: the tree is shallow, drift low."""

LOOPS = 12
"""The largest number of triangles of an edge that are examined."""


@njit(cache=True, nogil=True, error_model="numpy")
def agree(a: Row, b: Row, near: Near) -> bool:
    """Whether two poses differ by less than near: (cosine of half an angle, squared distance)."""
    if abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]) < near[0]:
        return False
    return (a[4] - b[4]) ** 2 + (a[5] - b[5]) ** 2 + (a[6] - b[6]) ** 2 <= near[1]


@njit(cache=True, nogil=True, error_model="numpy")
def directed(T_j_i: Floats, pairs: Ints, e: int, v: int) -> Row:
    """Edge e of T_j_i (m, 7) and pairs (m, 2) as the motion from scan v to the other scan."""
    a = load(T_j_i, e)
    return a if pairs[e, 0] == v else invert(a)


@njit(cache=True, nogil=True, error_model="numpy")
def mean(proposal: Floats, vote: Floats, best: int, near: Near) -> Row:
    """Mean of the proposals (k, 7), weighted by `vote` (k,), that agree with that of index `best`."""
    total, m = 0.0, np.zeros(7)
    b = load(proposal, best)
    for k in range(len(proposal)):
        a = load(proposal, k)
        if agree(a, b, near):
            sign = math.copysign(vote[k], a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3])
            for c in range(4):
                m[c] += sign * a[c]
            for c in range(4, 7):
                m[c] += vote[k] * a[c]
            total += vote[k]
    norm = math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2] + m[3] * m[3])
    return m[0] / norm, m[1] / norm, m[2] / norm, m[3] / norm, m[4] / total, m[5] / total, m[6] / total


@njit(cache=True, nogil=True, error_model="numpy")
def next_scan(queue: Ints, head: Ints, tail: Ints, cluster: Ints) -> int:
    """The free scan that is longest in the highest level of queue (levels, n); -1: none.

    A level holds its scans from `head` to `tail` (levels,); `head` moves on. A scan is free where `cluster` (n,) is -1.
    """
    for k in range(LEVELS - 1, -1, -1):
        while head[k] < tail[k]:
            v = queue[k, head[k]]
            head[k] += 1
            if cluster[v] < 0:
                return v
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def grow(
    pairs: Ints,
    T_j_i: Floats,
    trust: Floats,
    start: Ints,
    neighbour: Ints,
    edge: Ints,
    seeds: Ints,
    near: Near,
    least: float,
    voters: int,
) -> tuple[Floats, Ints, Ints]:
    """Poses (n, 7) within clusters, the cluster of each scan (0 the first), and the order scans were placed in.

    `trust` (m,): the vote of an edge. A cluster starts at the first free scan of `seeds` (n,) and grows while a free
    scan has proposals of support `least` or more; then the next one starts. A connected graph and `least` 0: one.
    """
    n = len(start) - 1
    T = np.zeros((n, 7))
    proposal, support, vote = np.empty((len(edge), 7)), np.empty(len(edge)), np.empty(len(edge))
    asked, best = np.zeros(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    queue = np.empty((LEVELS, n), dtype=np.int64)
    level, asking = np.empty(n, dtype=np.int64), np.full(n, -1)
    order, cluster = np.empty(n, dtype=np.int64), np.full(n, -1)
    head, tail = np.empty(LEVELS, dtype=np.int64), np.empty(LEVELS, dtype=np.int64)
    done = clusters = 0
    for seed in seeds:
        if cluster[seed] >= 0:
            continue
        head[:] = 0
        tail[:] = 0
        T[seed, 0] = 1.0
        v = seed
        while v >= 0:
            cluster[v] = clusters
            order[done] = v
            done += 1
            for a in range(start[v], start[v + 1]):
                u, e = neighbour[a], edge[a]
                if asking[u] != clusters:
                    asking[u], asked[u], level[u] = clusters, 0, -1
                if cluster[u] >= 0 or asked[u] >= voters:
                    continue
                slot = start[u] + asked[u]
                asked[u] += 1
                new = compose(load(T, v), directed(T_j_i, pairs, e, u))
                store(proposal, slot, new)
                support[slot] = vote[slot] = trust[e]
                for b in range(start[u], slot):
                    if agree(new, load(proposal, b), near):
                        support[slot] += vote[b]
                        support[b] += vote[slot]
                        if support[b] > support[best[u]]:
                            best[u] = b
                if slot == start[u] or support[slot] > support[best[u]]:
                    best[u] = slot
                most = support[best[u]]
                reached = min(max(int(math.log2(most) + LEVELS - 2), 0), LEVELS - 1)
                if most >= least and reached > level[u]:
                    level[u] = reached
                    queue[reached, tail[reached]] = u
                    tail[reached] += 1
            v = next_scan(queue, head, tail, cluster)
            if v >= 0:
                end = start[v] + asked[v]
                store(T, v, mean(proposal[start[v] : end], vote[start[v] : end], best[v] - start[v], near))
        clusters += 1
    return T, cluster, order


@njit(cache=True, nogil=True, error_model="numpy")
def loop_votes(
    low: int,
    high: int,
    pairs: Ints,
    T_j_i: Floats,
    trust: Floats,
    start: Ints,
    neighbour: Ints,
    edge: Ints,
    near: Near,
    out: Floats,
) -> None:
    """out (m,) of the edges low..high: their trust, times a factor from closed and open triangles.

    The factor is 1/2 without triangles. It approaches 1 with each closed triangle, and slowly 0 with open ones, as
    another of their edges may be the false one.
    """
    for e in range(low, high):
        i, j = pairs[e, 0], pairs[e, 1]
        a, b = start[i], start[j]
        closed = asked = 0
        while a < start[i + 1] and b < start[j + 1] and asked < LOOPS:
            if neighbour[a] < neighbour[b]:
                a += 1
            elif neighbour[a] > neighbour[b]:
                b += 1
            else:
                around = compose(invert(directed(T_j_i, pairs, edge[b], j)), directed(T_j_i, pairs, edge[a], i))
                closed += agree(load(T_j_i, e), around, near)
                asked += 1
                a += 1
                b += 1
        out[e] = trust[e] * (closed + 0.5) / (closed + 1 + 0.1 * (asked - closed))


@njit(cache=True, nogil=True, error_model="numpy")
def between(T: Floats, pairs: Ints, T_j_i: Floats) -> Floats:
    """Edges (m, 7) between clusters: T_J_I = T_j T_j_i inv(T_i), with T the poses within the clusters."""
    out = np.empty((len(pairs), 7))
    for e in range(len(pairs)):
        store(out, e, compose(compose(load(T, pairs[e, 1]), load(T_j_i, e)), invert(load(T, pairs[e, 0]))))
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def move(T: Floats, cluster: Ints, T_cluster: Floats) -> None:
    """T <- T_cluster T in place; T (n, 7), cluster (n,), T_cluster (clusters, 7)."""
    for v in range(len(T)):
        store(T, v, compose(load(T_cluster, cluster[v]), load(T, v)))


@njit(cache=True, nogil=True, error_model="numpy")
def vote_again(
    T: Floats,
    pairs: Ints,
    T_j_i: Floats,
    trust: Floats,
    start: Ints,
    neighbour: Ints,
    edge: Ints,
    order: Ints,
    near: Near,
    voters: int,
) -> int:
    """Move each scan of order (k,) to the pose that most of its edges agree on; returns the number moved.

    The poses T (n, 7) are changed in place.
    """
    proposal, vote, support = np.empty((voters, 7)), np.empty(voters), np.empty(voters)
    moved = 0
    for v in order:
        count = min(start[v + 1] - start[v], voters)
        if count == 0:
            continue
        here, supported = load(T, v), 0.0
        for k in range(count):
            a = start[v] + k * (start[v + 1] - start[v]) // count
            new = compose(load(T, neighbour[a]), directed(T_j_i, pairs, edge[a], v))
            store(proposal, k, new)
            support[k] = vote[k] = trust[edge[a]]
            if agree(new, here, near):
                supported += vote[k]
            for b in range(k):
                if agree(new, load(proposal, b), near):
                    support[k] += vote[b]
                    support[b] += vote[k]
        best = int(np.argmax(support[:count]))
        if not agree(load(proposal, best), here, near):
            if supported >= support[best]:
                continue
            moved += 1
        store(T, v, mean(proposal[:count], vote[:count], best, near))
    return moved
