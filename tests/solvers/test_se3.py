"""Rotations as matrices, quaternions and vectors: against scipy, and there and back at every angle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from miniloop_cli.geometry import se3

ANGLES_RAD = np.array([0.0, 1e-12, 1e-7, 1e-4, 2e-4, 3e-4, 0.1, 1.0, 3.0, np.pi - 1e-4, np.pi - 1e-8])
AXES = np.vstack([np.eye(3), -np.eye(3), np.random.default_rng(3).normal(size=(40, 3))])
VECTORS = (AXES / np.linalg.norm(AXES, axis=1, keepdims=True))[:, None] * ANGLES_RAD[:, None]


def test_quaternions_and_vectors_as_scipy_finds_them():
    R = Rotation.from_rotvec(VECTORS.reshape(-1, 3))
    q = se3.quaternions(R.as_matrix())
    np.testing.assert_allclose(q, R.as_quat(canonical=True), atol=1e-14)
    np.testing.assert_array_equal(se3.quaternions(R.as_matrix(), w_first=True), q[:, [3, 0, 1, 2]])
    np.testing.assert_allclose(se3.log_so3(R.as_matrix()).reshape(VECTORS.shape), VECTORS, rtol=1e-10, atol=1e-15)


@pytest.mark.parametrize("w_first", [False, True])
def test_quaternions_of_any_length_and_sign_are_rotations(w_first):
    q = np.random.default_rng(4).normal(size=(3, 20, 4)) * np.logspace(-3, 3, 20)[:, None]
    expected = Rotation.from_quat(q.reshape(-1, 4), scalar_first=w_first).as_matrix()
    np.testing.assert_allclose(se3.rotations(q, w_first).reshape(-1, 3, 3), expected, atol=1e-14)


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda axis: np.linalg.norm(axis) > 1e-3))
def test_half_turns_come_back(axis):
    """The vector's sign is free there, the rotation is not."""
    half_turn = 2 * np.outer(axis, axis) / np.dot(axis, axis) - np.eye(3)
    w = se3.log_so3(half_turn)
    assert np.linalg.norm(w) == pytest.approx(np.pi, abs=1e-7)
    np.testing.assert_allclose(se3.exp_so3(w), half_turn, atol=1e-7)
    np.testing.assert_allclose(se3.rotations(se3.quaternions(half_turn)), half_turn, atol=1e-14)


@pytest.mark.parametrize("shape", [(0,), (2, 0), (), (2, 3)])
def test_any_number_of_them(shape):
    R = np.broadcast_to(np.eye(3), (*shape, 3, 3))
    assert se3.quaternions(R).shape == (*shape, 4)
    assert se3.log_so3(R).shape == (*shape, 3)
    np.testing.assert_array_equal(se3.rotations(se3.quaternions(R)), R)


def test_a_matrix_that_is_not_quite_a_rotation_gives_a_unit_quaternion():
    noise = 1e-4 * np.random.default_rng(5).normal(size=(VECTORS.shape[0] * VECTORS.shape[1], 3, 3))
    R = Rotation.from_rotvec(VECTORS.reshape(-1, 3)).as_matrix()
    q = se3.quaternions(R + noise)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1, atol=1e-14)
    np.testing.assert_allclose(se3.rotations(q), R, atol=1e-3)
