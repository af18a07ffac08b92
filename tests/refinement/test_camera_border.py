"""The border of the parameters is that of the dense equations of poses, points and parameters."""

import numpy as np
from scipy.spatial.transform import Rotation

from miniloop_cli.refinement.camera_border import ParameterEquations, border
from miniloop_cli.refinement.point_equations import PointEquations
from miniloop_cli.refinement.track_rows import TrackRows

POSES, PARAMETERS, DAMPING = 4, 5, 0.03
LENGTHS = np.array([3, 0, 2, 4, 1])  # a point that nobody sees, too


def hat(x):
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def test_border_is_that_of_the_dense_equations():
    rng = np.random.default_rng(0)
    k, points = LENGTHS.sum(), len(LENGTHS)
    track = np.repeat(np.arange(points), LENGTHS)
    frame = np.concatenate([np.sort(rng.choice(POSES, n, replace=False)) for n in LENGTHS])
    tracks = TrackRows(np.concatenate([[0], np.cumsum(LENGTHS)]), frame.astype(np.uint32))
    R = Rotation.random(POSES, rng=rng).as_matrix()
    half = rng.normal(size=(k, 3, 3))
    seen = PointEquations(rng.normal(size=(3, k)), rng.normal(size=(k, 3)), half @ half.transpose(0, 2, 1))
    parameters = ParameterEquations(*(rng.normal(size=(k, *shape)) for shape in ((3, 5), (2, 5), (5,))))

    V, W, e = np.zeros((points, 3, 3)), np.zeros((points, 3, PARAMETERS)), np.zeros((points, 3))
    own, gradient = np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS)
    by_pose = np.zeros((POSES, 6, PARAMETERS))
    for row in range(k):
        p, A, turn = track[row], seen.hessian[row], R[frame[row]]
        V[p] += turn @ A @ turn.T
        W[p] += turn @ parameters.mixed[row]
        e[p] += turn @ seen.gradient[row]
        own += parameters.root[row].T @ parameters.root[row]
        gradient += parameters.gradient[row]
        B = np.hstack([hat(seen.p_cam[:, row]), -np.eye(3)])
        by_pose[frame[row]] += B.T @ parameters.mixed[row]
    own += DAMPING * np.diag(np.diag(own))
    inverse = np.linalg.inv(V + DAMPING * V * np.eye(3) + 1e-6 * np.eye(3))
    for p in range(points):
        own -= W[p].T @ inverse[p] @ W[p]
        gradient -= W[p].T @ inverse[p] @ e[p]
    for row in range(k):
        p, turn = track[row], R[frame[row]]
        B = np.hstack([hat(seen.p_cam[:, row]), -np.eye(3)])
        by_pose[frame[row]] -= B.T @ seen.hessian[row] @ turn.T @ inverse[p] @ W[p]

    L = np.linalg.cholesky(np.linalg.inv(inverse))
    diagonal = np.arange(3)
    L[:, diagonal, diagonal] = 1 / L[:, diagonal, diagonal]
    found = border(tracks, seen, parameters, R, L, DAMPING)
    np.testing.assert_allclose(found.own, own, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.gradient, gradient, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.by_pose, by_pose, rtol=1e-9, atol=1e-9)


def test_border_without_parameters_is_empty():
    tracks = TrackRows(np.array([0, 2]), np.array([0, 1], np.uint32))
    seen = PointEquations(np.ones((3, 2)), np.ones((2, 3)), np.tile(np.eye(3), (2, 1, 1)))
    nothing = ParameterEquations(np.zeros((2, 3, 0)), np.zeros((2, 2, 0)), np.zeros((2, 0)))
    found = border(tracks, seen, nothing, np.tile(np.eye(3), (2, 1, 1)), np.eye(3)[None], 0.1)
    assert found.own.shape == (0, 0)
    assert found.by_pose.shape == (2, 6, 0)
