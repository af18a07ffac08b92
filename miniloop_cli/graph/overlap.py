"""The overlap graph: an edge for each pair of scans with enough matches."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from miniloop_cli.typing import Ints, Pair

if TYPE_CHECKING:
    import networkx as nx


def overlap_graph(count: int, matches: Mapping[Pair, Ints]) -> nx.Graph:
    """Nodes 0..count-1, an edge a pair of scans with its number of `matches` (paper, section 4)."""
    import networkx as nx

    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    graph.add_edges_from((i, j, {"matches": len(rows)}) for (i, j), rows in matches.items())
    return graph
