"""Edge-disjoint decomposition of the overlap graph into mini-loops (paper, section 4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from miniloop_cli.graph.cycle_local_search import exchange, odd_pairs
from miniloop_cli.graph.edge_pool import Cycle, FreeEdges

if TYPE_CHECKING:
    import networkx as nx

__all__ = ["Cycle", "decompose"]


def decompose(graph: nx.Graph, longest: int = 5, method: str = "dfs") -> list[Cycle]:
    """Edge-disjoint cycles of `longest`, then `longest` - 1, ... 3 scans, then the remaining edges as pairs.

    `graph`: nodes are scan numbers; the edge attribute `matches` orders the search of method "support".
    Each edge is in exactly one of the returned tuples; consecutive scans of a tuple are joined by an edge, and for
    more than two scans so are the last and the first. No cycle of length n is left among the edges when the search
    for n - 1 begins.

    "dfs" is the paper's: a depth-first search over the scans in order of number. "support" begins with the edges
    that have the fewest matches and closes each over the strongest free edges, so that a weak edge shares a cycle with
    strong ones. Strong edges between scans of odd degree come last, as some of them are left over in any case. A local
    search then reduces the number of other edges left over (cycle_local_search.py).

    Raises ValueError for an unknown method.
    """
    if method not in ("dfs", "support"):
        raise ValueError(f"unknown decomposition '{method}'")
    strength = {(min(i, j), max(i, j)): data.get("matches", 0) for i, j, data in graph.edges(data=True)}
    neighbours = {i: sorted(graph[i]) for i in sorted(graph)}
    order, put_off = sorted(strength), []
    if method == "support":
        neighbours = {
            i: sorted(found, key=lambda j: (-strength[min(i, j), max(i, j)], j)) for i, found in neighbours.items()
        }
        order.sort(key=lambda pair: strength[pair])
        put_off = odd_pairs(strength) if longest > 2 else []
    free = FreeEdges(neighbours)
    free.take(put_off)
    cycles: list[Cycle] = []
    for length in range(longest, 2, -1):
        found = free.take_greedily(order, length)
        if method == "support":
            found = exchange(free, found, length)
            if put_off:
                free.give(put_off)
                put_off = []
                found = exchange(free, found + free.take_greedily(order, length), length)
        cycles += found
    return cycles + [pair for pair in sorted(order) if pair in free]
