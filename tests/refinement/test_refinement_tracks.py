import itertools

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.refinement.tracks import build_tracks


def as_sets(tracks):
    return {
        frozenset(
            zip(tracks.frame[tracks.track == k].tolist(), tracks.feature[tracks.track == k].tolist(), strict=True)
        )
        for k in range(tracks.count)
    }


def test_chains_matches_over_frames():
    tracks = build_tracks([0, 3, 5, 9], [(0, 1), (1, 2), (0, 2)], [[(0, 1), (2, 0)], [(1, 3)], np.zeros((0, 2), int)])
    assert as_sets(tracks) == {frozenset({(0, 0), (1, 1), (2, 3)}), frozenset({(0, 2), (1, 0)})}
    assert tracks.frame.tolist() == [0, 1, 2, 0, 1]
    assert tracks.track.tolist() == [0, 0, 0, 1, 1]
    assert tracks.dropped_matches == 0


def test_the_stronger_pair_wins_a_conflict():
    pairs, matches = [(0, 1), (1, 2), (0, 2)], [[(0, 0)], [(0, 0)], [(1, 0)]]
    weak_last = build_tracks([0, 2, 4, 6], pairs, matches, strength=[3, 2, 1])
    assert as_sets(weak_last) == {frozenset({(0, 0), (1, 0), (2, 0)})}
    weak_middle = build_tracks([0, 2, 4, 6], pairs, matches, strength=[3, 1, 2])
    assert as_sets(weak_middle) == {frozenset({(0, 0), (1, 0)}), frozenset({(0, 1), (2, 0)})}
    assert weak_last.dropped_matches == weak_middle.dropped_matches == 1


def test_short_tracks_can_be_left_out():
    tracks = build_tracks([0, 2, 4, 6], [(0, 1), (1, 2)], [[(0, 0), (1, 1)], [(0, 0)]], min_frames=3)
    assert as_sets(tracks) == {frozenset({(0, 0), (1, 0), (2, 0)})}


def test_nothing_to_chain():
    tracks = build_tracks([0, 4, 8], np.zeros((0, 2)), [])
    assert tracks.count == 0
    assert len(tracks.frame) == 0


@pytest.mark.parametrize(
    ("pairs", "matches"),
    [([(0, 1)], []), ([(0, 2)], [[(0, 0)]]), ([(0, 1)], [[(0, 4)]]), ([(0, 1)], [[(-1, 0)]])],
)
def test_refuses_numbers_that_do_not_fit(pairs, matches):
    with pytest.raises(ValueError, match=r"pairs|feature"):
        build_tracks([0, 4, 8], pairs, matches)


@st.composite
def match_graphs(draw):
    n = draw(st.integers(2, 5))
    counts = draw(st.lists(st.integers(1, 5), min_size=n, max_size=n))
    pairs = [p for p in itertools.combinations(range(n), 2) if draw(st.booleans())]
    matches = []
    for i, j in pairs:
        k = draw(st.integers(0, 4))
        matches.append([(draw(st.integers(0, counts[i] - 1)), draw(st.integers(0, counts[j] - 1))) for _ in range(k)])
    return np.concatenate([[0], np.cumsum(counts)]), pairs, matches


@settings(max_examples=150)
@given(match_graphs())
def test_tracks_are_consistent_and_complete(case):
    offsets, pairs, matches = case
    tracks = build_tracks(offsets, pairs, matches)
    keys = list(zip(tracks.track.tolist(), tracks.frame.tolist(), strict=True))
    assert keys == sorted(keys)
    assert len(set(keys)) == len(keys)  # a frame at most once in a track
    features = list(zip(tracks.frame.tolist(), tracks.feature.tolist(), strict=True))
    assert len(set(features)) == len(features)  # a feature at most in one track
    graph = nx.Graph(((i, a), (j, b)) for (i, j), rows in zip(pairs, matches, strict=True) for a, b in rows)
    whole = {frozenset(c) for c in nx.connected_components(graph)}
    found = as_sets(tracks)
    assert all(any(t <= c for c in whole) for t in found)
    clean = {c for c in whole if len({f for f, _ in c}) == len(c)}
    assert clean <= found  # components without conflict come out whole
    assert (tracks.dropped_matches == 0) == (clean == whole)
