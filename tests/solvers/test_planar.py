"""Known vertical: mirrored solutions, planar motion and known gravity, and why 1+1+1+1 has no solver."""

import numpy as np
import pytest
from solver_cases import distance

from miniloop_cli.bench.problems import random_problems
from miniloop_cli.geometry import se3
from miniloop_cli.solvers.batch import match_residuals
from miniloop_cli.solvers.planar2 import planar2
from miniloop_cli.solvers.planar3 import planar3
from miniloop_cli.solvers.planar4 import planar4


def pose(turn, shift):
    return se3.pose(se3.exp_so3(np.array([0, 0, turn])), np.asarray(shift, float))


def test_right_angle_by_hand():
    T = planar2(np.array([[1.0, 0, 0], [0, 0, 0]]), np.array([[0, 1.0, 2], [0, 0, 2.0]]))
    np.testing.assert_allclose(T[0, 0], pose(np.pi / 2, [0, 0, 2]), atol=1e-15)


def test_mirrored_arms_by_hand():
    """Both links of length 1 reach (1, 1) from the origin: first right then up, or first up then right."""
    p = np.array([[0, 0, 0], [0, 0, 0], [1.0, 0, 0]])
    q = np.array([[1.0, 0, 0], [0, 0, 0], [np.sqrt(2), 0, 0]])
    found = planar3(p, q)
    turns = np.sort(np.degrees(np.arctan2(found[:, 0, 1, 0], found[:, 0, 0, 0])))
    np.testing.assert_allclose(turns, [-90, 90], atol=1e-9)
    np.testing.assert_allclose(match_residuals(found, p, q, (1, 1, 1)), 0, atol=1e-12)


@pytest.mark.parametrize("solver", [planar3, planar4])
def test_both_arms_meet_every_match(solver, rng):
    p, q, truth = random_problems(rng, solver.matches, 200, upright=True)
    for i in range(len(p)):
        found = solver(p[i], q[i])
        assert len(found) == 2
        assert match_residuals(found, p[i], q[i], solver.matches).max() < 1e-9
        assert np.sort(distance(found, truth[i]))[0] < 1e-9


@pytest.mark.parametrize("solver", [planar2, planar3, planar4])
def test_planar_motion_stays_in_its_plane(solver, rng):
    """All z translations zero and points at any height: nothing lifts the scans."""
    p, q, _ = random_problems(rng, solver.matches, 50, upright=True)
    p[..., 2] = q[..., 2]
    T, counts = solver.solve_batch(p, q)
    assert counts.min() > 0
    assert np.abs(T[..., 2, 3]).max() < 1e-12
    np.testing.assert_array_equal(T[:, 0, :, 2, :3], np.broadcast_to([0, 0, 1], T[:, 0, :, 2, :3].shape))


def test_misfit_of_heights_is_spread_evenly():
    p = np.array([[0, 0, 0], [0, 0, 0], [1.0, 0, 0]])
    q = np.array([[1.0, 0, 0], [0, 0, 0], [np.sqrt(2), 0, 0.3]])
    found = planar3(p, q)
    np.testing.assert_allclose(found[:, :, 2, 3], 0.1)
    np.testing.assert_allclose(match_residuals(found, p, q, (1, 1, 1)), 0.1)


def test_out_of_reach_has_no_solution():
    p = np.array([[0, 0, 0], [0, 0, 0], [1.0, 0, 0]])
    q = np.array([[1.0, 0, 0], [0, 0, 0], [2.5, 0, 0]])
    assert planar3(p, q).shape == (0, 2, 4, 4)
    # Just out of reach, as by noise: the stretched arm.
    q[2, 0] = 2.001
    stretched = planar3(p, q)
    assert len(stretched) == 1
    np.testing.assert_allclose(stretched[0, 0], pose(0, [1, 0, 0]), atol=1e-12)


def constraint_rank(matches, free, rng):
    """(equations, unknowns, rank) of all matches of a random upright cycle, by the Jacobian at the truth.

    `free`: coordinates of an edge's translation that are unknown; 2 is planar motion, 3 known gravity.
    """
    p, q, truth = (a[0] for a in random_problems(rng, matches, 1, upright=True))
    if free == 2:
        q[:, 2], truth[:, 2, 3] = p[:, 2], 0.0
    edges = len(truth)

    def residuals(u):
        u = u.reshape(edges, 1 + free)
        T = np.stack([pose(u[e, 0], np.append(u[e, 1:], [0] * (3 - free))) @ truth[e] for e in range(edges)])
        chain = [*T, np.linalg.multi_dot(T[::-1])]
        moved = [chain[e] @ np.append(p[k], 1) for k, e in enumerate(np.repeat(range(edges + 1), matches))]
        return (np.array(moved)[:, :3] - q).ravel()

    unknowns = edges * (1 + free)
    assert np.abs(residuals(np.zeros(unknowns))).max() < 1e-12
    step = 1e-6
    J = np.stack([(residuals(step * e) - residuals(-step * e)) / (2 * step) for e in np.eye(unknowns)], axis=1)
    return len(J), unknowns, np.linalg.matrix_rank(J, tol=1e-6)


@pytest.mark.parametrize("free", [2, 3])
def test_planar_4_cycle_of_the_paper_is_underdetermined(free, rng):
    """1+1+1+1 (paper, sec. 3: "16 solutions"): one direction of motion is left that no match sees."""
    for _ in range(20):
        equations, unknowns, rank = constraint_rank((1, 1, 1, 1), free, rng)
        assert equations == 12 and unknowns == 3 * (1 + free)
        assert rank == unknowns - 1


@pytest.mark.parametrize("free", [2, 3])
@pytest.mark.parametrize("matches", [(1, 1, 1), (1, 1, 1, 2)])
def test_the_cycles_that_have_solvers_are_determined(matches, free, rng):
    for _ in range(20):
        _, unknowns, rank = constraint_rank(matches, free, rng)
        assert rank == unknowns


def test_the_family_of_1111_meets_all_its_matches(rng):
    """Any second turn within reach gives poses that meet all four matches exactly."""
    p, q, truth = (a[0] for a in random_problems(rng, (1, 1, 1, 1), 1, upright=True))
    turn = np.arctan2(truth[1, 1, 0], truth[1, 0, 0])
    for change in (-0.02, 0.0, 0.01, 0.03):
        middle = pose(turn + change, [0, 0, 0])
        middle[:3, 3] = q[1] - middle[:3, :3] @ p[1]
        # With the second edge fixed, scans 2 and 3 are one body: a 3-cycle of the remaining matches.
        through = np.array([p[0], se3.transform(se3.inverse(middle), p[2:3])[0], p[3]])
        arms = planar3(through, q[[0, 2, 3]])
        assert len(arms) == 2
        for first, last in arms:
            poses = np.stack([first, middle, last @ se3.inverse(middle)])
            assert match_residuals(poses, p, q, (1, 1, 1, 1)).max() < 1e-9
            if change == 0.0:
                continue
            assert np.abs(poses - truth).max() > 1e-3
