"""Partners: scans that must share their view, given their poses."""

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.graph.visibility import partners
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
