"""Alignments against exact motions and against scipy's."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.procrustes import align_points, align_rotations


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.floats(0.01, 100))
def test_the_similarity_is_found(seed, scale):
    rng = np.random.default_rng(seed)
    p, R, t = rng.normal(size=(10, 3)), se3.exp_so3(rng.normal(size=3)), rng.normal(size=3)
    found = align_points(p, scale * p @ R.T + t, with_scale=True)
    assert found.scale == pytest.approx(scale, rel=1e-9)
    np.testing.assert_allclose(found.R, R, atol=1e-9)
    np.testing.assert_allclose(found.t, t, atol=1e-8 * max(1, scale))


def test_noisy_points_are_aligned_as_scipy_does():
    rng = np.random.default_rng(2)
    p, q = rng.normal(size=(2, 20, 3))
    expected, _ = Rotation.align_vectors(q - q.mean(0), p - p.mean(0))
    np.testing.assert_allclose(align_points(p, q).R, expected.as_matrix(), atol=1e-9)


def test_a_mirror_image_is_never_aligned_by_a_reflection():
    p = np.random.default_rng(3).normal(size=(9, 3))
    assert np.linalg.det(align_points(p, p * [1, 1, -1]).R) == pytest.approx(1)


def test_coinciding_points_have_no_scale():
    with pytest.raises(MiniloopError, match="no scale can be found"):
        align_points(np.ones((4, 3)), np.random.default_rng(4).normal(size=(4, 3)), with_scale=True)


def test_rotations_are_aligned_and_weighted():
    R, common = Rotation.random(6, random_state=5).as_matrix(), Rotation.random(random_state=6).as_matrix()
    np.testing.assert_allclose(align_rotations(R, common @ R), common, atol=1e-12)
    spoilt = common @ R
    spoilt[0] = np.eye(3)
    found = align_rotations(R, spoilt, np.array([0.0, 1, 1, 1, 1, 1]))
    np.testing.assert_allclose(found, common, atol=1e-12)
