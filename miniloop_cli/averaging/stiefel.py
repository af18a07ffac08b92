"""Minimising the pose graph's quadratic form over rotations and translations, in three dimensions or more.

Y_i = [R_i t_i] (r, 4) with R_i' R_i = I: rotations for r = 3, and their relaxation for r = 4. A Riemannian
trust region with truncated conjugate gradients (Absil, Baker & Gallivan 2007), preconditioned by a factor of the form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.averaging.quadratic_form import Factor, QuadraticForm
from miniloop_cli.typing import Floats

MAX_STEPS, MAX_CG_STEPS = 60, 300
DECREASE = 1e-11  # of the cost: a step that gains less is the last
SHIFT = 1e-4  # of the mean diagonal; makes the form definite for the preconditioner


def multipliers(form: QuadraticForm, Y: Floats) -> Floats:
    """Lagrange's multipliers (n, 3, 3) of R_i' R_i = I, symmetric; their traces sum to the cost at the best t."""
    A = form.times(Y)[:, :3] @ np.swapaxes(Y[:, :3], 1, 2)
    return (A + np.swapaxes(A, 1, 2)) / 2


def cost(form: QuadraticForm, Y: Floats) -> float:
    """f(Y) of Y (n, 4, r)."""
    return float((Y * form.times(Y)).sum())


def tangent(Y: Floats, Z: Floats) -> Floats:
    """The projection of Z (n, 4, r) to the tangent space at Y."""
    A = Z[:, :3] @ np.swapaxes(Y[:, :3], 1, 2)
    out = Z.copy()
    out[:, :3] -= (A + np.swapaxes(A, 1, 2)) / 2 @ Y[:, :3]
    return out


def retract(Y: Floats, X: Floats) -> Floats:
    """Y + X, both (n, 4, r), with the nearest rotations."""
    out = Y + X
    U, _, Vt = np.linalg.svd(out[:, :3], full_matrices=False)
    out[:, :3] = U @ Vt
    return out


def best_translations(form: QuadraticForm, Y: Floats) -> Floats:
    """Y (n, 4, r) with the best translations for its rotations; the first one is zero."""
    from scipy.sparse.linalg import splu

    out = Y.copy()
    out[:, 3] = 0
    rest = form.times(out)[1:, 3]
    if len(rest):
        Q_tt = form.Q[3::4, 3::4][1:, 1:].tocsc()
        out[1:, 3] = -splu(Q_tt, permc_spec="NATURAL", options={"SymmetricMode": True}).solve(rest)
    return out


@dataclass(frozen=True)
class Minimum:
    """The end of the descent: Y (n, 4, r), its cost, the number of steps."""

    Y: Floats
    cost: float
    steps: int


def minimise(form: QuadraticForm, Y: Floats) -> Minimum:
    """The minimum reached by descent from Y (n, 4, r)."""
    diagonal = form.Q.diagonal().reshape(-1, 4)[:, :3]
    precondition = form.factor(shift=SHIFT * float(diagonal.mean()))
    f, radius = cost(form, Y), np.sqrt(len(Y))
    for step in range(1, MAX_STEPS + 1):
        gradient = tangent(Y, form.times(Y))
        X, promised = _step(form, Y, multipliers(form, Y), gradient, radius, precondition)
        if promised <= DECREASE * f or promised <= 1e-15 * form.kappa_sum:
            return Minimum(Y, f, step)
        proposed = retract(Y, X)
        f_new = cost(form, proposed)
        ratio = (f - f_new) / promised
        size = float(np.linalg.norm(X[:, :3]))
        if ratio < 0.25:
            radius = size / 4
        elif ratio > 0.75:
            radius = max(radius, 2 * size)
        if f_new < f:
            Y, f = proposed, f_new
    return Minimum(Y, f, MAX_STEPS)


def _step(
    form: QuadraticForm, Y: Floats, multiplier: Floats, gradient: Floats, radius: float, precondition: Factor
) -> tuple[Floats, float]:
    """A step X within the trust region (of rotations), and the decrease of f predicted by the quadratic model."""

    def hessian(X: Floats) -> Floats:
        out = form.times(X)
        out[:, :3] -= multiplier @ X[:, :3]
        return tangent(Y, out)

    X, HX = np.zeros_like(Y), np.zeros_like(Y)
    r = gradient
    z = tangent(Y, precondition.solve(r))
    p, rz = -z, float((r * z).sum())
    enough = rz * min(0.01, np.sqrt(rz))
    for _ in range(MAX_CG_STEPS):
        if rz <= max(enough, 0.0):
            break
        Hp = hessian(p)
        curvature = float((p * Hp).sum())
        alpha = rz / curvature if curvature > 0 else np.inf
        if curvature <= 0 or np.linalg.norm(X[:, :3] + alpha * p[:, :3]) >= radius:
            alpha = _to_boundary(X, p, radius)
            X, HX = X + alpha * p, HX + alpha * Hp
            break
        X, HX = X + alpha * p, HX + alpha * Hp
        r = r + alpha * Hp
        z = tangent(Y, precondition.solve(r))
        before, rz = rz, float((r * z).sum())
        p = -z + rz / before * p
    return X, -float((X * (2 * gradient + HX)).sum())


def _to_boundary(X: Floats, p: Floats, radius: float) -> float:
    """The alpha at which the rotations of X + alpha p reach the radius."""
    a, b = float((p[:, :3] ** 2).sum()), float((X[:, :3] * p[:, :3]).sum())
    c = float((X[:, :3] ** 2).sum()) - radius**2
    return (-b + np.sqrt(max(b * b - a * c, 0.0))) / max(a, 1e-300)
