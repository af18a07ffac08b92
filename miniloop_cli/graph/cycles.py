"""Edge-disjoint decomposition of the overlap graph into mini-loops (paper, section 4)."""

from __future__ import annotations

from collections.abc import Iterable

import networkx as nx

Cycle = tuple[int, ...]


def decompose(graph: nx.Graph, longest: int = 5, method: str = "dfs") -> list[Cycle]:
    """Edge-disjoint cycles of `longest`, then `longest` - 1, ... 3 scans, then the remaining edges as pairs.

    `graph`: nodes are scan numbers; the edge attribute `matches` orders the search of method "support".
    Each edge is in exactly one of the returned tuples; consecutive scans of a tuple are joined by an edge, and for
    more than two scans so are the last and the first. No cycle of length n is left among the edges when the search
    for n - 1 begins.

    "dfs" is the paper's: a depth-first search over the scans in order of number. "support" begins with the edges
    that have the fewest matches and closes each over the strongest edges that are left, so that a weak edge is
    carried by strong partners.
    """
    if method not in ("dfs", "support"):
        raise ValueError(f"unknown decomposition '{method}'")
    strength = {frozenset((i, j)): data.get("matches", 0) for i, j, data in graph.edges(data=True)}
    neighbours = {i: sorted(graph[i]) for i in sorted(graph)}
    if method == "support":
        neighbours = {
            i: sorted(found, key=lambda j: (-strength[frozenset((i, j))], j)) for i, found in neighbours.items()
        }
        order = sorted(strength, key=lambda edge: (strength[edge], sorted(edge)))
    else:
        order = sorted(strength, key=sorted)
    free = {i: dict.fromkeys(found) for i, found in neighbours.items()}
    cycles: list[Cycle] = []
    for length in range(longest, 2, -1):
        cycles += _cycles_of_length(free, [tuple(sorted(edge)) for edge in order], length)
    cycles += [(i, j) for i, j in sorted(tuple(sorted(edge)) for edge in order) if j in free[i]]
    return cycles


def _cycles_of_length(free: dict[int, dict[int, None]], edges: Iterable[tuple[int, ...]], length: int) -> list[Cycle]:
    """Greedy: for each edge in turn, close one cycle through it if there is one, and take its edges out of `free`."""
    cycles = []
    for i, j in edges:
        if j in free[i]:
            path = _path(free, [i, j], length)
            if path:
                cycles.append(tuple(path))
                for a, b in zip(path, path[1:] + path[:1], strict=True):
                    del free[a][b], free[b][a]
    return cycles


def _path(free: dict[int, dict[int, None]], path: list[int], length: int) -> list[int] | None:
    """Depth-first extension of a simple path to a cycle of `length` scans; None if there is none."""
    last, first = path[-1], path[0]
    if len(path) == length:
        return path if first in free[last] else None
    if len(path) == length - 1:
        # One scan is missing: it must be a neighbour of both ends. Looking it up is what makes the search fast.
        for scan in free[last]:
            if scan in free[first] and scan not in path:
                return [*path, scan]
        return None
    for scan in free[last]:
        if scan not in path:
            found = _path(free, [*path, scan], length)
            if found:
                return found
    return None
