"""Edges on no loop: against networkx, which looks at the whole graph."""

import networkx as nx
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.scene.view_graph import bridges, components
from miniloop_cli.verification.gating import reject_unsupported_bridges

COUNT = 9
pair = st.tuples(st.integers(0, COUNT - 1), st.integers(0, COUNT - 1)).filter(lambda ends: ends[0] < ends[1])


@given(st.dictionaries(pair, st.booleans(), max_size=16))
def test_as_networkx_finds_them(edges):
    """`edges`: pairs, and whether each is one of those that are asked about."""
    asked = np.array([ends for ends, some in edges.items() if some], np.int64).reshape(-1, 2)
    others = np.array([ends for ends, some in edges.items() if not some], np.int64).reshape(-1, 2)
    found = {tuple(asked[k].tolist()) for k in bridges(asked, components(COUNT, others))}
    loose = {tuple(sorted(ends)) for ends in nx.bridges(nx.Graph(list(edges)))}
    assert found == {tuple(ends) for ends in asked.tolist()} & loose


def test_a_lone_edge_of_few_inliers_falls_and_one_in_a_loop_stands():
    edges = [
        Edge(i, j, np.zeros((30, 2), int), np.arange(30) < inliers, verdict=Verdict.VERIFIED)
        for i, j, inliers in ((0, 1, 30), (0, 2, 12), (1, 2, 12), (2, 3, 12), (3, 4, 30))
    ]
    judged = reject_unsupported_bridges(EdgeTable.of(edges), 5, 20)
    assert judged.open.tolist() == [True, True, True, False, True]
    assert judged.rejection[3] == Rejection.UNSUPPORTED_BRIDGE
    assert judged.reasons()[3] == "only 12 inliers, and no loop of edges confirms it"
