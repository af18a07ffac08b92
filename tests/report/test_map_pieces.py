"""Recordings that nothing joins are set down beside each other, upright; those that are joined stay where they are."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.upward import up_direction
from miniloop_cli.report.viewer.map_pieces import set_down


def walk(seed):
    """Level cameras that turn on a walk of some metres, in a world of any direction."""
    rng = np.random.default_rng(seed)
    R = se3.exp_so3(np.linspace(0, 2.5, 30)[:, None] * np.array([0, -1.0, 0]))
    at = np.cumsum(rng.normal(scale=[0.1, 0.02, 0.1], size=(30, 3)), axis=0)
    world = se3.pose(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3) * 5)
    return world @ se3.pose(R, at)


@given(st.integers(0, 9999))
def test_pieces_stand_apart_and_upright(seed):
    walks = [walk(seed + k) for k in range(4)]
    piece = np.array([0, 1, 0, 2])
    T = set_down(walks, piece)
    np.testing.assert_allclose(np.linalg.det(T[:, :3, :3]), 1)
    np.testing.assert_array_equal(T[[0, 2]], np.tile(np.eye(4), (2, 1, 1)))
    up = up_direction(np.concatenate([walks[0], walks[2]]))
    for k in (1, 3):
        np.testing.assert_allclose(T[k, :3, :3] @ up_direction(walks[k]), up, atol=1e-6)
    shown = [(T[k] @ walks[k])[:, :3, 3] for k in range(4)]
    for a, b in ((0, 1), (2, 1), (1, 3)):
        assert np.linalg.norm(shown[a][:, None] - shown[b], axis=2).min() > 2


def test_one_piece_is_not_moved():
    np.testing.assert_array_equal(set_down([walk(1)], np.array([0])), np.eye(4)[None])
