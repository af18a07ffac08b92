"""Motions between frames as a term: derivatives, what a measured motion does to poses, open directions."""

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.refinement.motion_term import MotionTerm
from miniloop_cli.refinement.posegraph import refine_pose_graph


def random_poses(count, rng, angle=0.5):
    return se3.pose(se3.exp_so3(rng.normal(0, angle, (count, 3))), rng.normal(0, 1, (count, 3)))


def random_information(count, rng):
    A = rng.normal(0, 1, (count, 6, 6))
    return A @ A.transpose(0, 2, 1) + np.eye(6)


def test_derivatives_are_those_of_the_residuals(rng):
    poses, pairs = random_poses(5, rng), np.array([[0, 1], [3, 2], [4, 1]])
    term = MotionTerm.of(pairs, random_poses(3, rng), random_information(3, rng))
    _, jacobian = term.linearise(poses)
    for side in range(2):
        for k in range(6):
            step = np.zeros(6)
            step[k] = 1e-6
            moved = []
            for sign in (1, -1):
                changed = poses.copy()
                motion = se3.pose(se3.exp_so3(sign * step[:3]), sign * step[3:])
                changed[pairs[:, side]] = changed[pairs[:, side]] @ motion
                moved.append(term.linearise(changed)[0])
            # Frame 1 is in two rows, on the same side of both: each row feels its own frame alone.
            assert np.allclose((moved[0] - moved[1]) / 2e-6, jacobian[:, side, :, k], atol=1e-5 * abs(jacobian).max())


def test_the_squared_residual_is_that_of_the_information(rng):
    poses, information = random_poses(2, rng), random_information(1, rng)
    T_j_i = random_poses(1, rng)
    residual, _ = MotionTerm.of(np.array([[0, 1]]), T_j_i, information).linearise(poses)
    E = se3.inverse(poses[1]) @ poses[0] @ se3.inverse(T_j_i[0])
    r = np.concatenate([se3.log_so3(E[:3, :3]), E[:3, 3]])
    assert np.isclose((residual**2).sum(), r @ information[0] @ r)


def test_a_measured_motion_places_a_frame_that_nothing_else_ties(rng):
    T = random_poses(3, rng)
    edge = se3.inverse(T[1]) @ T[0]
    term = MotionTerm.of(np.array([[1, 2]]), (se3.inverse(T[2]) @ T[1])[None], 1e4 * np.eye(6)[None])
    start = T.copy()
    start[2] = start[2] @ se3.pose(se3.exp_so3(np.array([0.05, -0.02, 0.03])), np.array([0.1, 0.0, -0.1]))
    found = refine_pose_graph(start, [(0, 1)], edge[None], 1e4 * np.eye(6)[None], pose_terms=[term])
    assert np.allclose(found.T_world_cam, T, atol=1e-6)


def test_an_open_direction_does_not_pull(rng):
    information = np.diag([1.0, 1, 1, 1, 1, 0])
    term = MotionTerm.of(np.array([[0, 1]]), np.eye(4)[None], information[None])
    moved = np.array([np.eye(4), se3.pose(np.eye(3), np.array([0, 0, 5.0]))])
    assert np.allclose(term.linearise(moved)[0], 0)
