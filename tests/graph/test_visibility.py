"""Partners: scans that must share their view by their poses, or share matches."""

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.graph.visibility import best_partners, partners
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.points import ScanPoints

CAMERA = Camera(500, 500, 320, 240, 640, 480)


def test_scans_that_look_the_same_way_are_partners_and_back_to_back_ones_are_not():
    rng = np.random.default_rng(0)
    points = CAMERA.backproject(rng.uniform((0, 0), (640, 480), (300, 2)), rng.uniform(1, 3, 300))
    scans = [ScanPoints(points, np.zeros((300, 3, 3)))] * 4
    turn = se3.exp_so3(np.array([[0, 0, 0], [0, 0.1, 0], [0, 0.3, 0], [0, np.pi, 0]]))
    T_world_cam = se3.pose(turn, np.zeros((4, 3)))
    assert partners(T_world_cam, np.arange(4), scans, CAMERA, 3) == [(0, 1), (0, 2), (1, 2)]
    assert partners(T_world_cam, np.arange(4), scans, CAMERA, 1) == [(0, 1), (1, 2)]
    assert partners(T_world_cam, np.array([1, 3]), scans, CAMERA, 3) == []
    assert partners(T_world_cam, np.arange(4), scans, CAMERA, 1, np.array([0, 0, 1, 1])) == [(0, 2), (1, 2)]


def test_a_scan_without_points_has_no_partner():
    nothing = ScanPoints(np.zeros((0, 3)), np.zeros((0, 3, 3)))
    assert partners(np.tile(np.eye(4), (2, 1, 1)), np.arange(2), [nothing, nothing], CAMERA, 5) == []


def test_scans_that_crowd_the_view_do_not_displace_those_with_most_matches():
    rng = np.random.default_rng(0)
    points = CAMERA.backproject(rng.uniform((0, 0), (640, 480), (300, 2)), rng.uniform(1, 3, 300))
    scans = [ScanPoints(points, np.zeros((300, 3, 3)))] * 6
    turn = se3.exp_so3(np.array([[0, 0, 0], [0, 0.3, 0], [0, 0.01, 0], [0, -0.01, 0], [0, 0.31, 0], [0, np.pi, 0]]))
    T_world_cam = se3.pose(turn, np.zeros((6, 3)))
    edges = EdgeTable.of([_edge(0, 1, 90), _edge(0, 2, 20), _edge(1, 4, 60), _edge(0, 5, 80), _edge(1, 3, 10)])

    by_view = partners(T_world_cam, np.arange(6), scans, CAMERA, 1)
    assert (0, 1) not in by_view
    both = best_partners(T_world_cam, np.arange(6), scans, CAMERA, 1, edges)
    # One each: 0-1 for both of them, 2 and 3 have one edge only, 4-1 and 5-0.
    assert set(both) == {*by_view, (0, 1), (0, 2), (1, 3), (1, 4), (0, 5)}
    assert both == sorted(both)
    without_ends = best_partners(T_world_cam, np.array([1, 2, 3, 4]), scans, CAMERA, 1, edges)
    assert all(0 not in pair and 5 not in pair for pair in without_ends) and (1, 4) in without_ends
    assert best_partners(T_world_cam, np.arange(6), scans, CAMERA, 1, EdgeTable.of([])) == by_view


def _edge(i: int, j: int, inliers: int) -> Edge:
    return Edge(i, j, np.zeros((inliers, 2), int), np.ones(inliers, bool))
