"""Keyframes that an image is compared with once its pose is nearly known: those that show what it shows."""

import numpy as np
import pytest

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.mapping.locate import NEAREST, Locator

CAMERA = Camera(500, 500, 320, 240, 640, 480)


@pytest.fixture
def near():
    """near(keyframes, piece): of keyframes of pixels (n, 2) and depth each, those near the view from the origin."""
    rng = np.random.default_rng(0)

    def found(areas, piece):
        sample = [CAMERA.backproject(rng.uniform(low, high, (60, 2)), np.full(60, 2.0)) for low, high in areas]
        locator = Locator(None, CAMERA, [], [], np.array(piece), np.stack(sample), None)
        return locator.near(np.eye(4), 0).tolist()

    return found


WHOLE, HALF, DETAIL, BESIDE = (
    ((0, 0), (640, 480)),
    ((320, 0), (960, 480)),
    ((330, 250), (470, 350)),
    ((700, 0), (900, 480)),
)


def test_what_shows_the_view_comes_before_what_shows_a_part_of_it(near):
    """All points of the detail lie in view, more than of the half: it was taken from much nearer."""
    assert near([DETAIL, HALF, WHOLE, BESIDE], [0, 0, 0, 0]) == [2, 1]


def test_only_the_piece_counts_and_the_nearest_ones(near):
    assert near([WHOLE, WHOLE], [0, 1]) == [0]
    assert len(near([WHOLE] * (NEAREST + 3), [0] * (NEAREST + 3))) == NEAREST


def test_what_lies_behind_is_not_near():
    sample = CAMERA.backproject(np.random.default_rng(0).uniform((0, 0), (640, 480), (60, 2)), np.full(60, 2.0))[None]
    locator = Locator(None, CAMERA, [], [], np.zeros(1, int), sample, None)
    assert locator.near(se3.pose(np.diag([-1.0, 1.0, -1.0]), np.zeros(3)), 0).tolist() == []
