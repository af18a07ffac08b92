"""A certificate, by the dual problem, that a minimum of the pose graph is global; a descent direction if it is not.

With Lagrange's multipliers of the rotations, sum of tr Lambda_i = f, the matrix S = Q - blockdiag(Lambda_i), the
translations eliminated, bounds every other arrangement R': f(R') = f(R) + tr(R' S R'^T) >= f(R) + 3n lambda_min(S).
This holds also if the descent has not converged (Rosen et al., "SE-Sync", IJRR 2019; for rotations alone Eriksson,
Olsson, Kahl & Chin, CVPR 2018). Whether S + eta I has a negative eigenvalue is read from the signs of the pivots of its
factor, as iterative eigenvalue solvers converge to the exact zeros of the free origin instead of negative values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.averaging.quadratic_form import QuadraticForm
from miniloop_cli.averaging.stiefel import best_translations, cost, minimise, multipliers, retract
from miniloop_cli.geometry import se3
from miniloop_cli.typing import Floats

GAPS = (1e-6, 1e-5, 1e-4)  # bounds on (f - f*) / f that are tried; any of them certifies a minimum
ROUNDING = 1e-14  # of the largest diagonal entry of Q: smaller shifts are below the rounding of the factor
EXACT = 1e-8  # f per weight of rotation (rad^2 twice) below which edges fit exactly, to thousandths of a degree
LENGTHS = 2.0 ** -np.arange(12)  # step lengths along `way_out` that are tried


@dataclass(frozen=True)
class Bound:
    """f(Y) - f* <= gap * f(Y). `way_out` (n, 3), where S has a negative eigenvalue: its eigenvector."""

    cost: float
    gap: float
    way_out: Floats | None = None

    @property
    def certified(self) -> bool:
        """Whether no other poses can fit significantly better."""
        return self.gap <= GAPS[-1]


def bound(form: QuadraticForm, Y: Floats) -> Bound:
    """The bound on the cost of all other poses, for the same edges and weights, relative to Y (n, 4, r)."""
    Y = best_translations(form, Y)
    f, n = cost(form, Y), form.count
    if f <= EXACT * form.kappa_sum:
        return Bound(f, 0.0)
    of_rotations = multipliers(form, Y)
    least = ROUNDING * float(form.Q.diagonal().max())

    def definite(shift: float) -> bool:
        try:
            return form.factor(of_rotations, shift).definite
        except RuntimeError:  # a pivot is exactly zero
            return False

    for gap in GAPS:
        shift = max(gap * f / (3 * n), least)
        if 3 * n * shift <= GAPS[-1] * f and definite(shift):
            return Bound(f, 3 * n * shift / f)
    shift = max(GAPS[-1] * f / (3 * n), least)
    while not definite(shift):
        shift *= 8
    lowest, way_out = _lowest(form, of_rotations, shift)
    tight = -1.01 * lowest
    if least < tight < shift and definite(tight):
        shift = tight
    return Bound(f, min(3 * n * shift / f, 1.0), way_out)


def _lowest(form: QuadraticForm, of_rotations: Floats, shift: float) -> tuple[float, Floats]:
    """Lowest eigenvalue of S and its vector (n, 3), where S + shift I is positive definite.

    The inverse of the whole matrix, between rotations, is that of S + shift I: translations are eliminated by it.
    """
    from scipy.sparse.linalg import LinearOperator, eigsh

    factor, n = form.factor(of_rotations, shift), form.count

    def inverse(x: Floats) -> Floats:
        Z = np.zeros((n, 4, 1))
        Z[:, :3, 0] = x.reshape(n, 3)
        return factor.solve(Z)[:, :3].ravel()

    operator = LinearOperator((3 * n, 3 * n), matvec=inverse, dtype=float)
    start = np.random.default_rng(0).normal(size=3 * n)
    values, vectors = eigsh(operator, k=1, which="LA", v0=start, tol=1e-6)
    return 1 / float(values[0]) - shift, vectors[:, 0].reshape(n, 3)


def escaped(form: QuadraticForm, Y: Floats, way_out: Floats) -> Floats:
    """The minimum (n, 4, 3) reached from the minimum Y through four and five dimensions.

    Steps of the Riemannian staircase (Boumal 2015): with one more dimension, Y is not a minimum, and `way_out` leads
    down. Four do not suffice: a ring with one turn too many cannot be unwound in four dimensions, as the frames of
    three vectors there are rotations with loops that cannot be contracted; in five it can. The result is rotated so
    that most of it lies in three dimensions, and descends there.
    """
    lower = _descended(form, Y, way_out)
    again = bound(form, lower)
    if again.way_out is not None:
        lower = _descended(form, lower, again.way_out)
    flat = lower[:, :3].reshape(-1, lower.shape[2])
    turned = lower @ np.linalg.eigh(flat.T @ flat)[1][:, ::-1][:, :3]
    if (np.linalg.det(turned[:, :3]) < 0).mean() > 0.5:
        turned[:, :, 2] *= -1
    turned[:, :3] = se3.project_so3(turned[:, :3])
    return minimise(form, best_translations(form, turned)).Y


def _descended(form: QuadraticForm, Y: Floats, way_out: Floats) -> Floats:
    """The minimum (n, 4, r + 1) below Y (n, 4, r) along `way_out` in one more dimension."""
    lifted = np.concatenate([Y, np.zeros((form.count, 4, 1))], axis=2)
    up = np.zeros_like(lifted)
    up[:, :3, -1] = way_out / np.abs(way_out).max()
    starts = (best_translations(form, retract(lifted, length * up)) for length in LENGTHS)
    return minimise(form, min(starts, key=lambda start: cost(form, start))).Y
