"""Local search for a decomposition that leaves fewer edges: cycles are released and replaced by others.

A cycle takes two edges from each of its nodes, so a node of odd degree always keeps an edge. Any decomposition leaves
at least half as many edges as there are odd nodes; a greedy one leaves two to four times as many.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice

import numpy as np

from miniloop_cli.graph.edge_pool import Cycle, FreeEdges, ring
from miniloop_cli.typing import Pair

PASSES, PATIENCE = 20, 3  # over all cycles; passes without gain after which the search ends
WAYS = 60  # cycles through an edge that are considered


def odd_pairs(strength: Mapping[Pair, int]) -> list[Pair]:
    """Edges that join nodes of odd degree in pairs, the strongest first: these are best left out of cycles.

    Without them, all degrees are even except those of odd nodes without a partner.
    """
    odd: set[int] = set()
    for pair in strength:
        odd ^= set(pair)
    chosen = []
    for i, j in sorted(strength, key=lambda pair: (-strength[pair], pair)):
        if i in odd and j in odd:
            odd -= {i, j}
            chosen.append((i, j))
    return chosen


def exchange(free: FreeEdges, cycles: list[Cycle], length: int) -> list[Cycle]:
    """Cycles of `length` over edges of `cycles` and free ones, at least as many; `free` is kept up to date.

    Each cycle in turn is released, and replaced by two where that is possible. Otherwise it is replaced by one that
    concentrates the free edges at few nodes (largest sum of squared degrees), where they can form cycles later.
    If no cycle of `length` is free before, none is free afterwards.
    """
    cycles, rng, idle = list(cycles), np.random.default_rng(0), 0
    for _ in range(PASSES):
        before = len(cycles)
        for k in range(before):
            # A new cycle must leave and enter the old one along free edges.
            if sum(free.degree(node) > 0 for node in cycles[k]) >= 2:
                cycles[k], *more = _again(free, cycles[k], length, rng)
                cycles += more
        idle = 0 if len(cycles) > before else idle + 1
        if idle == PATIENCE:
            break
    return cycles


def _again(free: FreeEdges, cycle: Cycle, length: int, rng: np.random.Generator) -> list[Cycle]:
    """One or more cycles of `length` over this one's edges and free ones; they are taken."""
    edges = ring(cycle)
    free.give(edges)
    ways: dict[frozenset[Pair], Cycle] = {}
    for edge in edges:
        for way in list(islice(free.cycles_through(edge, length), WAYS)):
            name = frozenset((min(pair), max(pair)) for pair in ring(way))
            if name in ways:
                continue
            ways[name] = way
            free.take(ring(way))
            more = free.take_greedily(edges, length)
            if more:
                return [way, *more]
            free.give(ring(way))
    crowding = {name: sum(1 - free.degree(node) for node in way) for name, way in ways.items()}
    most = max(crowding.values())
    best = [ways[name] for name in ways if crowding[name] == most]
    chosen = best[rng.integers(len(best))]
    free.take(ring(chosen))
    return [chosen]
