"""The equations of point terms over several blocks of rows: their gradient is that of the cost, for any threads."""

import numpy as np
import pytest

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.depth_term import DepthTerm
from miniloop_cli.refinement.pixel_term import PixelTerm
from miniloop_cli.refinement.point_equations import point_equations
from miniloop_cli.refinement.robust import Robust
from miniloop_cli.runtime.blocks import BLOCK, Blocks

ROWS = 2 * BLOCK + 1000


@pytest.fixture(scope="module")
def observed():
    """Points (3, ROWS) near their measurements, and the two terms; depth is missing in some rows."""
    rng = np.random.default_rng(3)
    x, y, z = rng.uniform((-1, -1, 1), (1, 1, 4), (ROWS, 3)).T
    camera = Camera(500.0, 510.0, 319.5, 239.5, 640, 480)
    px = np.stack([500 * x / z + 319.5, 510 * y / z + 239.5]) + rng.standard_normal((2, ROWS))
    z_m = np.where(np.arange(ROWS) % 7 == 0, np.nan, z + 0.01 * rng.standard_normal(ROWS))
    terms = [
        PixelTerm(px, camera, 1.0, Robust("geman-mcclure", 2.0)),
        DepthTerm(z_m, np.full(ROWS, 0.01), Robust("cauchy", 2.0)),
    ]
    return np.stack([x, y, z]), terms


def test_the_gradient_is_the_slope_of_the_cost_in_every_block(observed):
    p_cam, terms = observed
    equations, cost = point_equations(terms, p_cam)
    for row in (0, BLOCK - 1, BLOCK, 2 * BLOCK, ROWS - 1):
        single = [term.of(np.array([row])) for term in terms]
        for axis in range(3):
            step = np.zeros((3, 1))
            step[axis] = 1e-6
            up, down = (point_equations(single, p_cam[:, row : row + 1] + sign * step)[1] for sign in (1, -1))
            assert equations.gradient[row, axis] == pytest.approx((up - down) / 2e-6, rel=1e-5, abs=1e-4)
    parts = [point_equations([t.of(np.arange(k, ROWS, 10)) for t in terms], p_cam[:, k::10])[1] for k in range(10)]
    assert cost == pytest.approx(sum(parts), rel=1e-12)


def test_threads_change_no_byte(observed):
    p_cam, terms = observed
    alone, cost = point_equations(terms, p_cam)
    with Blocks(3) as blocks:
        shared, same_cost = point_equations(terms, p_cam, blocks=blocks)
    assert same_cost == cost
    assert all(np.array_equal(a, b) for a, b in zip(alone, shared, strict=True))
