import numpy as np

from benchmarks.experiments.pose_errors import normalised_errors
from miniloop_cli.geometry import se3
from miniloop_cli.refinement.gauge import with_own_errors


def step(xi):
    return se3.pose(se3.exp_so3(xi[..., :3]), xi[..., 3:])


def test_errors_of_single_frames_are_relative_to_the_fixed_one():
    rng = np.random.default_rng(0)
    T = step(rng.normal(size=(5, 6)))
    roots = 1e-3 * rng.normal(size=(5, 6, 6))
    own = roots @ np.swapaxes(roots, 1, 2)
    covariance = with_own_errors(np.zeros((5, 6, 6)), T, own, 2)
    errors = []
    for _ in range(2000):
        off = T @ step(np.einsum("nij,nj->ni", roots, rng.normal(size=(5, 6))))
        errors.append(normalised_errors(T, T[2] @ se3.inverse(off[2]) @ off, covariance))
    assert not covariance[2].any()
    np.testing.assert_allclose(np.square(errors).mean(axis=0), 1, atol=0.15)


def test_frames_that_nothing_ties_stay_unknown():
    T = step(np.random.default_rng(1).normal(size=(3, 6)))
    covariance = np.stack([np.zeros((6, 6)), np.eye(6), np.diag(np.full(6, np.inf))])
    found = with_own_errors(covariance, T, np.broadcast_to(np.eye(6), (3, 6, 6)), 0)
    assert np.array_equal(found[2], covariance[2])
    assert (np.linalg.eigvalsh(found[1]) > 2).all()
