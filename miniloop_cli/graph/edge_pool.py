"""The edges of a graph that no cycle has taken yet, and the search for cycles among them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

Pair = tuple[int, int]
Cycle = tuple[int, ...]


def ring(cycle: Cycle) -> list[Pair]:
    """The edges of a closed cycle, as it is walked."""
    return list(zip(cycle, cycle[1:] + cycle[:1], strict=True))


class FreeEdges:
    """Neighbours of each node along free edges, in the order in which the search prefers them."""

    def __init__(self, neighbours: Mapping[int, Iterable[int]]) -> None:
        self.of = {node: dict.fromkeys(found) for node, found in neighbours.items()}

    def __contains__(self, pair: Pair) -> bool:
        return pair[1] in self.of[pair[0]]

    def degree(self, node: int) -> int:
        """Free edges at a node."""
        return len(self.of[node])

    def take(self, pairs: Iterable[Pair]) -> None:
        """Remove these edges from the free ones."""
        for a, b in pairs:
            del self.of[a][b], self.of[b][a]

    def give(self, pairs: Iterable[Pair]) -> None:
        """Return these edges to the free ones; the search considers them last."""
        for a, b in pairs:
            self.of[a][b] = self.of[b][a] = None

    def cycles_through(self, pair: Pair, length: int) -> Iterator[Cycle]:
        """Every simple cycle of `length` nodes that begins with this edge, depth first."""
        return self._extensions(pair, length) if pair in self else iter(())

    def take_greedily(self, pairs: Iterable[Pair], length: int) -> list[Cycle]:
        """Through each edge in turn, the first cycle of `length` there is; they are taken."""
        found = []
        for pair in pairs:
            cycle = next(self.cycles_through(pair, length), None)
            if cycle:
                self.take(ring(cycle))
                found.append(cycle)
        return found

    def _extensions(self, path: Cycle, length: int) -> Iterator[Cycle]:
        if len(path) == length - 1:
            # The one missing node must be a neighbour of both ends; looking it up keeps the search fast.
            for node in self.of[path[-1]]:
                if node in self.of[path[0]] and node not in path:
                    yield (*path, node)
            return
        for node in self.of[path[-1]]:
            if node not in path:
                yield from self._extensions((*path, node), length)
