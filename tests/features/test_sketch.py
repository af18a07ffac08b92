"""Matching by sketches against exact matching, for descriptors of every kind."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.features.detect import compact, comparable
from miniloop_cli.features.lsh_match import CANDIDATES, LANES, match_sketched, sketch
from miniloop_cli.features.match import match


def two_views(kind, count, rng):
    """Stored descriptors (count, d) of one place seen twice; a third of the second are of something else."""
    if kind == "orb":
        a = rng.integers(0, 256, (count, 32), dtype=np.uint8)
        b = a ^ (rng.random((count, 32, 8)) < 0.06).dot(1 << np.arange(8)).astype(np.uint8)
    else:
        a = np.minimum(rng.exponential(25, (count, 128)), 255).astype(np.uint8)
        b = np.clip(a + rng.normal(0, 8, a.shape), 0, 255).astype(np.uint8)
    b[: count // 3] = rng.permuted(b[: count // 3], axis=1)
    return a, b[rng.permutation(count)]


@pytest.mark.parametrize(("kind", "ratio2"), [("rootsift", 0.64), ("orb", 0.8)])
def test_nearly_all_that_exact_matching_finds_is_found(kind, ratio2):
    stored = two_views(kind, 900, np.random.default_rng(1))
    exact = {tuple(row) for row in match(*(comparable(found, kind) for found in stored), 0.8)}
    found = {tuple(row) for row in match_sketched(*sketch([compact(d, kind)[0] for d in stored]), 900, ratio2)}
    assert len(exact) > 500
    assert len(exact & found) > 0.97 * len(exact)
    assert len(found) < 1.1 * len(exact)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.integers(0, 40), st.integers(1, 50))
def test_matches_are_one_to_one_sorted_within_count_and_pass_the_ratio_test(seed, n, m, count):
    rng = np.random.default_rng(seed)
    a, b = (rng.integers(0, 3, (k, 8), dtype=np.uint8) for k in (n, m))  # many ties
    found = match_sketched(*sketch([a, b]), count, 0.8)
    assert np.all(np.diff(found[:, 0]) > 0)
    assert len(set(found[:, 1].tolist())) == len(found)
    distance2 = ((a[:, None].astype(int) - b[None]) ** 2).sum(axis=2)
    for i, j in found:
        assert i < min(n, count)
        assert j < min(m, count)
        assert np.sum(distance2[i, : min(m, count)] * 0.8 > distance2[i, j]) >= min(CANDIDATES, m, count) - 1


def test_the_nearest_is_found_where_sketches_are_equal():
    a = np.zeros((1, 64), np.uint8)
    b = np.full((3 * LANES + 5, 64), 200, np.uint8)
    b[3 * LANES + 2] = 1  # in the last, incomplete group of columns
    assert match_sketched(*sketch([a, b]), 1000, 0.8).tolist() == [[0, 3 * LANES + 2]]


@pytest.mark.slow
def test_nothing_to_match_is_no_match():
    empty, some, one = (np.ones((k, 128), np.uint8) for k in (0, 3, 1))
    for a, b in ((empty, some), (some, empty), (some, one), (empty, empty)):
        assert match_sketched(*sketch([a, b]), 100, 0.64).shape == (0, 2)
