"""Exact matching: OpenCV's brute force is the oracle."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miniloop_cli.features.match import match


def opencv(a, b, ratio, norm):
    """Mutual nearest neighbours with the ratio test on the first side, by OpenCV."""
    matcher = cv2.BFMatcher(norm)
    forward, backward = matcher.knnMatch(a, b, k=2), matcher.match(b, a)
    back = {m.queryIdx: m.trainIdx for m in backward}
    return {
        (m.queryIdx, m.trainIdx)
        for m, n in forward
        if m.distance < ratio * n.distance and back[m.trainIdx] == m.queryIdx
    }


@pytest.mark.parametrize(("n", "m", "d"), [(300, 280, 128), (17, 5, 64), (1, 2, 128), (64, 33, 61)])
def test_real_descriptors_match_as_opencv_does(n, m, d):
    rng = np.random.default_rng(n)
    a = rng.normal(size=(n, d)).astype(np.float32)
    b = np.concatenate(
        [a[: m // 2] + 0.1 * rng.normal(size=(min(n, m // 2), d)), rng.normal(size=(m - min(n, m // 2), d))]
    )
    b = b.astype(np.float32)
    assert {tuple(row) for row in match(a, b, 0.8)} == opencv(a, b, 0.8, cv2.NORM_L2)


@pytest.mark.parametrize("width", [32, 61, 64])
def test_binary_descriptors_match_as_opencv_does_where_nothing_ties(width):
    rng = np.random.default_rng(width)
    a = rng.integers(0, 256, (200, width), dtype=np.uint8)
    b = a[rng.permutation(200)].copy()
    b[:, 0] ^= rng.integers(0, 4, 200, dtype=np.uint8)
    found = {tuple(row) for row in match(a, b, 0.8)}
    assert found == opencv(a, b, 0.8, cv2.NORM_HAMMING)
    assert len(found) == 200


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(2, 40))
def test_a_match_is_one_to_one_sorted_and_truly_mutual(seed, n, m):
    rng = np.random.default_rng(seed)
    a, b = (rng.integers(0, 3, (k, 8)).astype(np.float32) for k in (n, m))  # many ties
    found = match(a, b, 0.9)
    assert np.all(np.diff(found[:, 0]) > 0)
    assert len(set(found[:, 1])) == len(found)
    distance = np.linalg.norm(a[:, None] - b[None], axis=2)
    for i, j in found:
        assert distance[i, j] == distance[i].min() == distance[:, j].min()
        assert distance[i, j] < 0.9 * np.sort(distance[i])[1] + 1e-6


def test_nothing_to_match_is_no_match():
    empty = np.zeros((0, 128), np.float32)
    some = np.ones((3, 128), np.float32)
    assert match(empty, some).shape == match(some, empty).shape == match(some, some[:1]).shape == (0, 2)
