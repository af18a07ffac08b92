"""Decomposition into cycles: each edge once, real cycles, nothing left that could be one, few edges left over."""

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.graph.cycle_local_search import exchange, odd_pairs
from miniloop_cli.graph.cycles import decompose
from miniloop_cli.graph.edge_pool import FreeEdges, ring

METHODS = ["dfs", "support"]


def weighted(graph, seed=0):
    rng = np.random.default_rng(seed)
    for i, j in sorted(graph.edges):
        graph[i][j]["matches"] = int(rng.integers(12, 300))
    return graph


@st.composite
def graphs(draw):
    nodes = draw(st.integers(1, 14))
    pairs = [(i, j) for i in range(nodes) for j in range(i + 1, nodes)]
    graph = nx.empty_graph(nodes)
    graph.add_edges_from(draw(st.lists(st.sampled_from(pairs), unique=True)) if pairs else [])
    return weighted(graph)


def edges_of(cycle):
    return {frozenset(pair) for pair in (ring(cycle) if len(cycle) > 2 else [cycle])}


def left_over(cycles):
    return sum(len(cycle) == 2 for cycle in cycles)


@settings(max_examples=60)
@given(graphs(), st.sampled_from(METHODS), st.integers(2, 7))
def test_every_edge_is_in_exactly_one_real_cycle(graph, method, longest):
    cycles = decompose(graph, longest, method)
    assert all(2 <= len(cycle) == len(set(cycle)) <= longest for cycle in cycles)
    assert [len(cycle) for cycle in cycles] == sorted((len(cycle) for cycle in cycles), reverse=True)
    covered = [edge for cycle in cycles for edge in edges_of(cycle)]
    assert sorted(map(sorted, covered)) == sorted(map(sorted, graph.edges))


@settings(max_examples=40)
@given(graphs(), st.sampled_from(METHODS), st.integers(3, 6))
def test_no_cycle_of_a_length_is_left_when_shorter_ones_are_sought(graph, method, longest):
    cycles = decompose(graph, longest, method)
    for length in range(longest, 2, -1):
        left = nx.Graph(tuple(edge) for cycle in cycles if len(cycle) < length for edge in edges_of(cycle))
        assert not any(len(cycle) == length for cycle in nx.simple_cycles(left, length_bound=length))


@settings(max_examples=30)
@given(graphs(), st.sampled_from(METHODS), st.randoms(use_true_random=False))
def test_the_order_in_which_a_graph_was_built_does_not_matter(graph, method, random):
    edges = list(graph.edges(data=True))
    random.shuffle(edges)
    other = nx.empty_graph(0)
    other.add_nodes_from(random.sample(sorted(graph), len(graph)))
    other.add_edges_from((j, i, data) for i, j, data in edges)
    assert decompose(other, 5, method) == decompose(graph, 5, method)


@pytest.mark.parametrize("method", METHODS)
def test_known_graphs(method):
    assert decompose(nx.complete_graph(3), 5, method) == [(0, 1, 2)]
    assert decompose(nx.path_graph(4), 5, method) == [(0, 1), (1, 2), (2, 3)]
    assert decompose(nx.complete_graph(4), 2, method) == sorted(nx.complete_graph(4).edges)
    assert [len(c) for c in decompose(nx.cycle_graph(6), 6, method)] == [6]
    assert left_over(decompose(nx.cycle_graph(6), 5, method)) == 6
    # All nodes of Petersen's graph are odd: five edges at least are left, and it has nothing shorter than 5-cycles.
    assert [len(c) for c in decompose(nx.petersen_graph(), 5, method)] == [5, 5, 2, 2, 2, 2, 2]


def test_complete_graphs_of_odd_size_are_used_up():
    for nodes in (7, 9, 11, 13):
        assert left_over(decompose(nx.complete_graph(nodes), 5, "support")) <= 1
    with pytest.raises(ValueError, match="unknown decomposition"):
        decompose(nx.complete_graph(3), 5, "breadth")


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("nodes", "share", "part"), [(60, 0.3, 0.5), (60, 0.15, 0.9)])
def test_fewer_edges_are_left_over_than_by_the_papers_search(nodes, share, part, seed):
    # A node of odd degree keeps an edge; what is left beyond that is the decomposition's doing.
    graph = weighted(nx.gnp_random_graph(nodes, share, seed=seed), seed)
    least = sum(degree % 2 for _, degree in graph.degree) // 2
    support, dfs = (left_over(decompose(graph, 5, method)) for method in ("support", "dfs"))
    assert 0 <= support - least <= part * (dfs - least)


def test_weak_edges_get_strong_partners():
    weakest_partner = {method: [] for method in METHODS}
    for seed in range(4):
        graph = weighted(nx.gnp_random_graph(50, 0.3, seed=seed), seed)
        strength = {frozenset((i, j)): data["matches"] for i, j, data in graph.edges(data=True)}
        for method, found in weakest_partner.items():
            for cycle in decompose(graph, 5, method):
                matches = sorted(strength[edge] for edge in edges_of(cycle))
                if matches[0] < 30:
                    found.append(matches[1] if len(matches) > 1 else 0)
    assert np.median(weakest_partner["support"]) > 1.3 * np.median(weakest_partner["dfs"])


def test_odd_pairs_join_odd_nodes_strongest_first():
    strength = {(0, 1): 5, (1, 2): 9, (2, 3): 7, (0, 4): 30, (4, 5): 1, (4, 6): 1, (1, 7): 50}
    # Degrees: 0 2, 1 3, 2 2, 3 1, 4 3, 5 1, 6 1, 7 1.
    assert odd_pairs(strength) == [(1, 7), (4, 5)]


@settings(max_examples=40)
@given(graphs(), st.integers(3, 5))
def test_exchange_keeps_the_edges_and_loses_no_cycle(graph, length):
    free = FreeEdges({i: sorted(graph[i]) for i in graph})
    found = free.take_greedily(sorted(graph.edges), length)
    after = exchange(free, list(found), length)
    assert len(after) >= len(found) and all(len(set(cycle)) == length for cycle in after)
    left = {frozenset((i, j)) for i in graph for j in free.of[i]}
    taken = [edge for cycle in after for edge in edges_of(cycle)]
    assert len(taken) == len(set(taken)) and left.isdisjoint(taken)
    assert left | set(taken) == set(map(frozenset, graph.edges))
