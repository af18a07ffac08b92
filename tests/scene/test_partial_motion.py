"""Motions known in part: which directions are open, and what is left without them."""

import numpy as np
import pytest

from miniloop_cli.scene.partial_motion import BELIEVED, MAX_OPENNESS, closed, openness, without_open


def with_sigmas(sigmas, rng=None):
    """Information (6, 6) with these standard deviations, in BELIEVED, along the axes or along turned ones."""
    axes = np.eye(6) if rng is None else np.linalg.qr(rng.normal(size=(6, 6)))[0]
    inner = (axes * np.asarray(sigmas, float) ** -2) @ axes.T
    return inner / BELIEVED / BELIEVED[:, None]


@pytest.mark.parametrize("turned", [False, True])
def test_openness_is_the_largest_standard_deviation(turned, rng):
    sigmas = [0.1, 0.2, 0.1, 0.7, 0.3, 0.1]
    assert openness(with_sigmas(sigmas, rng if turned else None)) == pytest.approx(0.7)


def test_a_direction_that_nothing_tells_is_infinitely_open():
    wall = np.diag([1e6, 1e6, 0, 0, 0, 1e6])
    assert openness(wall) == np.inf and not closed(wall)
    both = np.stack([wall, with_sigmas(np.ones(6))])
    assert openness(both).tolist() == [np.inf, pytest.approx(1)] and closed(both).tolist() == [False, True]


def test_closed_allows_for_what_makes_a_motion_less_certain():
    assert closed(with_sigmas(np.full(6, 0.99 * MAX_OPENNESS)))
    assert not closed(with_sigmas([0.1] * 5 + [1.01 * MAX_OPENNESS]))


def test_open_directions_lose_all_information_and_others_none(rng):
    axes = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    kept = (axes[:, :4] * 4.0) @ axes[:, :4].T / BELIEVED / BELIEVED[:, None]
    weak = (axes[:, 4:] * [0.9, 0.0]) @ axes[:, 4:].T / BELIEVED / BELIEVED[:, None]
    assert np.allclose(without_open(kept + weak, 0.004), kept, rtol=1e-9, atol=1e-9 * kept.max())


def test_a_small_share_of_a_large_information_is_noise():
    sure = with_sigmas([0.01] * 5 + [0.5])  # 4 of 10,000
    assert openness(without_open(sure, 1e-3)) == np.inf
    assert openness(without_open(sure, 1e-4)) == pytest.approx(0.5)
