"""Edges as one table: what it is given comes back, and verdicts change only where they may."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.verdict import Rejection, Verdict


def edge(i, j, matches, inliers, verdict=Verdict.VERIFIED, rejection=Rejection.NONE, **more):
    rows = np.arange(2 * matches).reshape(matches, 2) + 100 * i + j
    T = np.eye(4)
    T[:3, 3] = i, j, matches
    return Edge(i, j, rows, np.arange(matches) < inliers, T, verdict=verdict, rejection=rejection, **more)


pairs = st.tuples(st.integers(0, 6), st.integers(0, 6)).filter(lambda ends: ends[0] < ends[1])
sizes = st.integers(0, 9).flatmap(lambda n: st.tuples(st.just(n), st.integers(0, n)))
some_edges = st.dictionaries(pairs, st.tuples(sizes, st.sampled_from(Verdict)), max_size=8).map(
    lambda found: [edge(*ends, *size, verdict=verdict) for ends, (size, verdict) in found.items()]
)


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in one.__dataclass_fields__)


@given(some_edges)
def test_edges_come_back_sorted(edges):
    table = EdgeTable.of(edges)
    back = table.edges()
    assert [e.pair for e in back] == sorted(e.pair for e in edges)
    assert all(same(a, b) for a, b in zip(sorted(edges, key=lambda e: e.pair), back, strict=True))
    assert table.inlier_count.tolist() == [e.inlier_count for e in back]
    assert table.match_count.tolist() == [len(e.matches) for e in back]
    assert all(np.array_equal(table.inlier_rows(k), e.matches[e.inliers]) for k, e in enumerate(back))
    assert same(EdgeTable.from_arrays(table.arrays()), table)


@given(some_edges, st.data())
def test_a_subset_is_the_table_of_these_edges(edges, data):
    table = EdgeTable.of(edges)
    mask = np.array(data.draw(st.lists(st.booleans(), min_size=len(table), max_size=len(table))), bool)
    expected = EdgeTable.of([e for e, kept in zip(table.edges(), mask, strict=True) if kept])
    assert same(table.subset(mask), expected) or not mask.any()
    assert same(table.subset(np.flatnonzero(mask)), table.subset(mask))


@given(some_edges, st.data())
def test_tables_are_one_table(edges, data):
    of = data.draw(st.lists(st.integers(0, 2), min_size=len(edges), max_size=len(edges)))
    tables = [EdgeTable.of([e for e, k in zip(edges, of, strict=True) if k == table]) for table in range(3)]
    found, expected = EdgeTable.concatenated(tables), EdgeTable.of(edges)
    assert same(found, expected) or not edges


@given(some_edges)
def test_a_rejected_edge_keeps_its_first_reason(edges):
    table = EdgeTable.of(edges)
    everything = np.ones(len(table), bool)
    once = table.reject(everything, Rejection.LOOKS_DIFFERENT, 0.25)
    assert not once.open.any()
    assert (once.rejection[table.open] == Rejection.LOOKS_DIFFERENT).all()
    assert np.array_equal(once.rejection[~table.open], table.rejection[~table.open])
    assert same(once.reject(everything, Rejection.UNCLOSED_TRIANGLES), once)
    assert same(once.judged_as(table, everything), table)


def test_replaced_edges_take_the_place_of_their_pairs():
    table = EdgeTable.of([edge(0, 1, 5, 2, Verdict.REJECTED), edge(2, 3, 4, 4)])
    changed = table.replaced([edge(0, 1, 9, 9), edge(1, 2, 3, 3)])
    assert changed.pairs.tolist() == [[0, 1], [1, 2], [2, 3]]
    assert changed.inlier_count.tolist() == [9, 3, 4]


def test_reasons_in_words():
    table = EdgeTable.of(
        [
            edge(0, 1, 20, 7, loops=3),
            edge(0, 2, 20, 6, Verdict.WEAK, Rejection.FEW_INLIERS, detail=(6, 20)),
            edge(0, 3, 20, 12),
        ]
    ).reject(np.array([False, False, True]), Rejection.CONTRADICTS_POSES, 12.34, 0.5)
    assert table.reasons() == [
        "7 inliers of 20 matches; 3 loops over verified edges agree",
        "6 inliers of 20 matches",
        "contradicts the other edges by 12.3 deg, 50 cm",
    ]


@pytest.mark.parametrize("rejection", Rejection)
def test_every_rejection_has_a_name_and_a_sentence(rejection):
    said = rejection.sentence(3.0, 0.5)
    assert bool(said) == bool(rejection.label) == (rejection != Rejection.NONE)
    assert "{" not in said
