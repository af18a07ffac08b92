"""The equations of points: over several blocks, with rows that are silent for a while; how many sums are held."""

import time

import numpy as np
import pytest

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.block_system import BlockSystem
from miniloop_cli.refinement.bundle_problem import Bundle
from miniloop_cli.refinement.depth_term import DepthTerm
from miniloop_cli.refinement.pixel_term import PixelTerm
from miniloop_cli.refinement.point_equations import PointEquations, point_equations
from miniloop_cli.refinement.robust import Robust
from miniloop_cli.refinement.schur import reduce_tracks
from miniloop_cli.refinement.track_rows import TrackRows
from miniloop_cli.runtime.blocks import BLOCK, Blocks

ROWS = 2 * BLOCK + 1000


@pytest.fixture
def equations(rng):
    half = rng.normal(size=(12, 3, 3))
    p_cam = rng.normal(size=(3, 12)) + np.array([[0.0], [0.0], [3.0]])
    return PointEquations(p_cam, rng.normal(size=(12, 3)), half @ np.swapaxes(half, 1, 2))


def reduced(tracks, seen):
    system = BlockSystem(np.zeros(4, bool), tracks.pairs(4))
    S, g, L = np.zeros((len(system), 6, 6)), np.zeros((4, 6)), np.zeros((3, 3, 3))
    reduce_tracks(0, 3, tracks, seen, np.tile(np.eye(3), (4, 1, 1)), 1e-3, system.index(), S, g, L)
    return S, g, L


def test_silent_rows_count_as_if_they_were_not_there(equations):
    """Three points, each seen by four frames."""
    tracks = TrackRows(np.array([0, 4, 8, 12]), np.tile(np.arange(4, dtype=np.uint32), 3))
    silent = np.array([1, 2, 9])
    kept = ~np.isin(np.arange(12), silent)
    S, g, L = reduced(tracks.subset(kept), equations.subset(kept))
    with equations.silent(silent) as seen:
        quiet = reduced(tracks, seen)
    blocks = np.flatnonzero(S.any(axis=(1, 2)))
    assert np.array_equal(blocks, np.flatnonzero(quiet[0].any(axis=(1, 2))))
    for found, expected in zip(quiet, (S, g, L), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_silent_rows_speak_again_whatever_happened(equations):
    gradient, hessian = equations.gradient.copy(), equations.hessian.copy()
    with pytest.raises(np.linalg.LinAlgError), equations.silent(np.array([0, 3])):
        assert not equations.gradient[[0, 3]].any() and not equations.hessian[[0, 3]].any()
        raise np.linalg.LinAlgError
    assert np.array_equal(equations.gradient, gradient) and np.array_equal(equations.hessian, hessian)


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_no_more_sums_than_jobs_wait_to_be_taken(jobs):
    """Threads that run ahead would each leave a sum as large as the whole system."""
    bundle = Bundle.__new__(Bundle)
    bundle.jobs, bundle._bounds = jobs, [(k, k + 1) for k in range(12)]
    made, taken = [], []

    def work(low, high):
        made.append(low)
        return low

    for part in bundle._in_chunks(work):
        taken.append(part)
        time.sleep(0.01)  # others have time to run ahead
        assert len(made) <= len(taken) + jobs
    assert taken == list(range(12))


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
