"""`python -m benchmarks growth`: which frames see the same place again, and which loops edges close."""

import numpy as np
import pytest

from benchmarks.experiments import growth
from miniloop_cli.simulation.layout import Layout
from miniloop_cli.simulation.tour import duration_s

K = np.array([[100.0, 0, 79.5], [0, 100, 59.5], [0, 0, 1]])


def wall(*poses):
    """Depth (n, 120, 160) of the plane z = 2 m seen from (x, angle about y) each; poses (n, 4, 4)."""
    T = np.tile(np.eye(4), (len(poses), 1, 1))
    for k, (x, angle) in enumerate(poses):
        T[k, :3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        T[k, 0, 3] = x
    v, u = np.mgrid[:120, :160]
    rays = np.linalg.solve(K, np.stack([u.ravel(), v.ravel(), np.ones(u.size)])).T
    toward = np.einsum("nj,ij->in", rays, T[:, 2, :3])
    return np.where(toward > 0.1, 2 / np.maximum(toward, 0.1), 0).reshape(-1, 120, 160).astype(np.float32), T


def test_frames_that_overlap_after_a_while_are_found():
    # The view is 3.2 m wide: 1.5 m aside half of it is left, 2.5 m aside a fifth; the last one looks the other way.
    depth_m, T = wall((0, 0), (0.1, 0), (1.5, 0), (2.5, 0), (0, np.pi))
    pairs = growth.seen_again(depth_m, T, K, np.array([0.0, 1, 20, 40, 60]))
    assert pairs.tolist() == [[0, 2], [1, 2], [2, 3]]
    assert growth.seen_again(depth_m, T, K, np.arange(5.0)).tolist() == []


def test_a_wall_between_hides_what_is_behind():
    depth_m, T = wall((0, 0), (0, 0))
    depth_m[1] = 1.0
    assert growth.seen_again(depth_m, T, K, np.array([0.0, 30])).tolist() == []


def test_an_edge_closes_a_loop_if_both_ends_are_near():
    pairs = np.array([[10.0, 40], [10, 50], [90, 200]])
    edges = np.array([[100.0, 200], [9.5, 40.9], [10.5, 52.1]])
    assert growth.joined_by(pairs, edges).tolist() == [True, False, False]
    assert growth.joined_by(pairs, np.empty((0, 2))).tolist() == [False] * 3


@pytest.mark.parametrize("frames", [100, 3000, 10_000])
def test_rooms_are_walked_at_a_persons_pace(frames):
    rooms = growth.rooms_for(frames)
    assert rooms % 2 == 0 and duration_s(Layout(rooms + 2)) > frames / 30
    assert rooms == 2 or duration_s(Layout(rooms)) <= frames / 30
