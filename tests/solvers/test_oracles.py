"""Independent solutions of the same equations: IK-Geo's subproblems, Procrustes, and least squares from many starts."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from solver_cases import poses

from miniloop_cli.bench.problems import random_problems
from miniloop_cli.solvers.cycle3 import cycle3
from miniloop_cli.solvers.cycle4 import cycle4
from miniloop_cli.solvers.cycle5 import cycle5
from miniloop_cli.solvers.pairwise import pairwise


class Edge:
    """An edge with two matches written another way: x -> g + Rot(k, angle) A (x - h), A any turn of the axes."""

    def __init__(self, p, q):
        self.h, self.g = p[0], q[0]
        d, self.k = (p[1] - p[0]) / np.linalg.norm(p[1] - p[0]), (q[1] - q[0]) / np.linalg.norm(q[1] - q[0])
        self.A = Rotation.align_vectors([self.k], [d])[0].as_matrix()

    def pose(self, angle):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(angle * self.k).as_matrix() @ self.A
        T[:3, 3] = self.g - T[:3, :3] @ self.h
        return T

    def angle(self, T):
        return (Rotation.from_matrix(T[:3, :3] @ self.A.T).as_rotvec() @ self.k) % (2 * np.pi)


def circular(a, b):
    return np.abs(np.exp(1j * np.asarray(a)) - np.exp(1j * np.asarray(b)))


def problem(solver, seed):
    p, q, truth = random_problems(np.random.default_rng(seed), solver.matches, 1)
    return p[0], q[0], truth[0]


@pytest.mark.parametrize("seed", range(30))
def test_cycle3_is_subproblem_2_extended(seed):
    sp2E = pytest.importorskip("linearSubproblemSltns.sp2E_lib")
    p, q, _ = problem(cycle3, seed)
    first, second = Edge(p[0:2], q[0:2]), Edge(p[2:4], q[2:4])
    a, b = sp2E.sp2E_run(
        second.A @ (first.g - second.h),
        second.A @ first.A @ (p[4] - first.h),
        q[4] - second.g,
        second.A @ first.k,
        second.k,
    )
    found = cycle3(p, q)[0]
    assert circular(first.angle(found[0]), a) < 1e-6
    assert circular(second.angle(found[1]), -b) < 1e-6


@pytest.mark.parametrize("seed", range(30))
def test_cycle4_is_subproblem_5(seed):
    sp5 = pytest.importorskip("linearSubproblemSltns.sp5_lib")
    p, q, _ = problem(cycle4, seed)
    first, second, third = (Edge(p[2 * e : 2 * e + 2], q[2 * e : 2 * e + 2]) for e in range(3))
    try:
        c, b, a = sp5.sp5_run(
            third.h - second.g,
            third.A.T @ (q[6] - third.g),
            second.A @ (first.g - second.h),
            second.A @ first.A @ (p[6] - first.h),
            third.A.T @ third.k,
            second.k,
            second.A @ first.k,
        )
    except TypeError:
        pytest.skip("the oracle stumbles over a complex square root")
    oracle = np.stack([a, b, -np.array(c)], axis=1)
    T, counts = cycle4.solve_batch(p[None], q[None], nearly_real=0.0)
    edges = (first, second, third)
    found = np.array([[e.angle(T) for e, T in zip(edges, s, strict=True)] for s in poses(T[0, : counts[0]])])
    # The oracle misses real roots that rounding makes complex; all it reports must be ours.
    assert len(oracle) <= counts[0]
    for angles in oracle:
        assert circular(found, angles).max(axis=1).min() < 1e-5


@pytest.mark.parametrize("seed", range(20))
def test_pairwise_is_procrustes_on_exact_data(seed):
    p, q, _ = problem(pairwise, seed)
    R = Rotation.align_vectors(q - q.mean(axis=0), p - p.mean(axis=0))[0].as_matrix()
    np.testing.assert_allclose(pairwise(p, q)[0, 0, :3, :3], R, atol=1e-9)


def distinct(solutions, tolerance=1e-4):
    kept = []
    for x in solutions:
        if all(circular(x, y).max() > tolerance for y in kept):
            kept.append(x)
    return kept


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5, 6])
def test_number_of_solutions_of_cycle4_by_many_starts(seed):
    """Newton on the three closing equations in the three angles finds as many solutions as the quartic, not more."""
    p, q, _ = problem(cycle4, seed)
    edges = [Edge(p[2 * e : 2 * e + 2], q[2 * e : 2 * e + 2]) for e in range(3)]

    def closing(angles):
        x = p[6]
        for edge, angle in zip(edges, angles, strict=True):
            T = edge.pose(angle)
            x = T[:3, :3] @ x + T[:3, 3]
        return x - q[6]

    rng = np.random.default_rng(seed)
    ends = [least_squares(closing, start, xtol=1e-14) for start in rng.uniform(-np.pi, np.pi, (120, 3))]
    solutions = distinct([end.x for end in ends if np.abs(end.fun).max() < 1e-9])
    _, counts = cycle4.solve_batch(p[None], q[None], nearly_real=0.0)
    assert len(solutions) == counts[0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_closing_a_5_cycle_by_many_starts_has_one_solution(seed):
    """All six closing equations leave the truth alone, and it is the solver's best."""
    p, q, truth = problem(cycle5, seed)
    edges = [Edge(p[2 * e : 2 * e + 2], q[2 * e : 2 * e + 2]) for e in range(4)]

    def closing(angles):
        x = p[8:]
        for edge, angle in zip(edges, angles, strict=True):
            T = edge.pose(angle)
            x = x @ T[:3, :3].T + T[:3, 3]
        return (x - q[8:]).ravel()

    rng = np.random.default_rng(seed)
    ends = [least_squares(closing, start, xtol=1e-14) for start in rng.uniform(-np.pi, np.pi, (80, 4))]
    solutions = distinct([end.x for end in ends if np.abs(end.fun).max() < 1e-9])
    assert len(solutions) == 1
    best = cycle5(p, q, best=True)[0]
    np.testing.assert_allclose(best, truth, atol=1e-8)
    np.testing.assert_allclose(best, [edge.pose(a) for edge, a in zip(edges, solutions[0], strict=True)], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_number_of_roots_of_the_octic_by_many_starts(seed):
    """The equations the octic stands for, in other variables: x(a, b) and y(c, s) of equal height and length."""
    p, q, _ = problem(cycle5, seed)
    first, second, third, fourth = (Edge(p[2 * e : 2 * e + 2], q[2 * e : 2 * e + 2]) for e in range(4))
    y = (q[8:] - fourth.g) @ fourth.A
    axis = fourth.A.T @ fourth.k
    across = np.cross(axis, y)
    along = np.outer(y @ axis, axis)
    upright = y - along

    def mismatch(u):
        x = p[8:]
        for edge, angle in zip((first, second), u[:2], strict=True):
            T = edge.pose(angle)
            x = x @ T[:3, :3].T + T[:3, 3]
        # Points of scan 3 turned into scan 4's frame but for the third angle, which keeps height and length.
        left = (x - third.h) @ third.A.T
        right = along + u[2] * upright - u[3] * across + fourth.h - third.g
        # |right|^2 as if (u2, u3) were a unit vector: only so is it linear, as in the elimination.
        excess = (1 - u[2] ** 2 - u[3] ** 2) * (upright**2).sum(axis=1)
        heights = (left - right) @ third.k
        lengths = (left**2).sum(axis=1) - (right**2).sum(axis=1) - excess
        return np.concatenate([heights, lengths])

    rng = np.random.default_rng(seed)
    starts = np.column_stack([rng.uniform(-np.pi, np.pi, (200, 2)), rng.uniform(-1.5, 1.5, (200, 2))])
    ends = [least_squares(mismatch, start, xtol=1e-14, max_nfev=200) for start in starts]
    solutions = distinct([end.x[:2] for end in ends if np.abs(end.fun).max() < 1e-10])
    _, counts = cycle5.solve_batch(p[None], q[None], nearly_real=0.0)
    assert len(solutions) == counts[0]
