"""The equations of points: rows that say nothing for a while; how many sums of them are held."""

import time

import numpy as np
import pytest

from miniloop_cli.refinement.block_system import BlockSystem
from miniloop_cli.refinement.bundle_problem import Bundle
from miniloop_cli.refinement.point_equations import PointEquations
from miniloop_cli.refinement.schur import reduce_tracks
from miniloop_cli.refinement.track_rows import TrackRows


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
