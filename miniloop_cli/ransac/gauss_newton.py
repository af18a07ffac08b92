"""Gauss-Newton on a cycle of scans: the joint least squares of all its matches over 6 (n - 1) pose parameters.

Every edge contributes its own 6 x 6 normal equations in a perturbation xi = (w, v) of its relative pose,
x -> exp(w) x + v after the pose. A chain edge perturbs itself; the closing pose is the product of the chain, and its
perturbation is the sum of the chain's, each carried to the last scan by the adjoint of the remaining poses.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from miniloop_cli.ransac.edge_normal_equations import MATH, edge_normal_equations
from miniloop_cli.ransac.matches import Packed
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats

CAUCHY2 = 9.0  # robust scale (squared, in sigmas) of every fit
OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
# Fast math only in functions that Python calls, with everything inlined: other functions are compiled in several
# copies, which fast math would let differ in the last digits.
WHOLE: dict[str, Any] = {**OPTIONS, "fastmath": MATH}


@njit(**OPTIONS)
def compose_into(T: Floats, C: Floats) -> None:
    """C (3, 4) becomes the product T[n-2] ... T[0] of (n-1, 3, 4) poses."""
    for i in range(3):
        for j in range(4):
            C[i, j] = T[0, i, j]
    for e in range(1, T.shape[0]):
        for j in range(4):
            x, y, z = C[0, j], C[1, j], C[2, j]
            for i in range(3):
                C[i, j] = T[e, i, 0] * x + T[e, i, 1] * y + T[e, i, 2] * z
        for i in range(3):
            C[i, 3] += T[e, i, 3]


@njit(**OPTIONS)
def closing_jacobians(T: Floats, A: Floats) -> None:
    """A (n-1, 6, 6): a perturbation xi of edge e of T (n-1, 3, 4) perturbs the closing pose by A[e] xi.

    A[e] is the adjoint of the later poses T[n-2] ... T[e+1].
    """
    last = T.shape[0] - 1
    R, t = np.zeros((3, 3)), np.zeros(3)
    R[0, 0] = R[1, 1] = R[2, 2] = 1.0
    for e in range(last, -1, -1):
        if e < last:
            for i in range(3):
                t[i] += R[i, 0] * T[e + 1, 0, 3] + R[i, 1] * T[e + 1, 1, 3] + R[i, 2] * T[e + 1, 2, 3]
            for i in range(3):
                x, y, z = R[i, 0], R[i, 1], R[i, 2]
                for j in range(3):
                    R[i, j] = x * T[e + 1, 0, j] + y * T[e + 1, 1, j] + z * T[e + 1, 2, j]
        for j in range(3):
            for i in range(3):
                A[e, i, j] = A[e, i + 3, j + 3] = R[i, j]
                A[e, i, j + 3] = 0.0
            A[e, 3, j] = t[1] * R[2, j] - t[2] * R[1, j]
            A[e, 4, j] = t[2] * R[0, j] - t[0] * R[2, j]
            A[e, 5, j] = t[0] * R[1, j] - t[1] * R[0, j]


@njit(**OPTIONS)
def perturb(T: Floats, xi: Floats) -> None:
    """T (3, 4) <- [exp(w) | v] T, in place."""
    w0, w1, w2 = xi[0], xi[1], xi[2]
    angle2 = w0 * w0 + w1 * w1 + w2 * w2
    if angle2 < 1e-12:
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = np.sqrt(angle2)
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle2
    for j in range(4):
        x, y, z = T[0, j], T[1, j], T[2, j]
        cx, cy, cz = w1 * z - w2 * y, w2 * x - w0 * z, w0 * y - w1 * x
        T[0, j] = x + a * cx + b * (w1 * cz - w2 * cy)
        T[1, j] = y + a * cy + b * (w2 * cx - w0 * cz)
        T[2, j] = z + a * cz + b * (w0 * cy - w1 * cx)
    for i in range(3):
        T[i, 3] += xi[3 + i]


@njit(**OPTIONS)
def cholesky_solve(A: Floats, b: Floats) -> bool:
    """Solve A x = b, A (n, n) symmetric positive definite; b (n,) becomes x, A is overwritten. False if singular."""
    n = A.shape[0]
    for j in range(n):
        d = A[j, j]
        limit = 1e-13 * d
        for k in range(j):
            d -= A[j, k] * A[j, k]
        if not d > limit:
            return False
        d = np.sqrt(d)
        A[j, j] = d
        for i in range(j + 1, n):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = s / d
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= A[i, k] * b[k]
        b[i] = s / A[i, i]
    for i in range(n - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, n):
            s -= A[k, i] * b[k]
        b[i] = s / A[i, i]
    return True


@njit(**WHOLE)
def cycle_system(
    T: Floats,
    matches: Packed,
    inflation2: float,
    gate2: float,
    c2: float,
    upright: bool,
    H: Floats,
    g: Floats,
    edge_H: Floats,
) -> float:
    """Normal equations H (6(n-1),)^2, g of a whole cycle; edge_H (edges, 6, 6) those of each edge; returns the cost.

    T (n-1, 3, 4): the chain. Weights as in `edge_normal_equations`. `upright`: rotations are about z only (known
    vertical), so the other two parameters are held.
    """
    chain, edges = T.shape[0], matches.start.shape[0] - 1
    poses, b, A, HA = np.empty((chain + 1, 3, 4)), np.empty(6), np.empty((chain, 6, 6)), np.empty((6, 6))
    for e in range(chain):
        for i in range(3):
            for j in range(4):
                poses[e, i, j] = T[e, i, j]
    compose_into(T, poses[chain])
    for i in range(6 * chain):
        g[i] = 0.0
        for j in range(6 * chain):
            H[i, j] = 0.0
    cost = 0.0
    for e in range(edges):
        first, last = matches.start[e], matches.start[e + 1]
        cost += edge_normal_equations(poses[e], matches, first, last, inflation2, gate2, c2, edge_H[e], b)
        if e < chain:
            for i in range(6):
                g[6 * e + i] += b[i]
                for j in range(6):
                    H[6 * e + i, 6 * e + j] += edge_H[e, i, j]
    if edges > chain:
        closing_jacobians(T, A)
        for f in range(chain):
            for i in range(6):
                for j in range(6):
                    total = 0.0
                    for k in range(6):
                        total += edge_H[chain, i, k] * A[f, k, j]
                    HA[i, j] = total
            for i in range(6):
                for k in range(6):
                    g[6 * f + i] += A[f, k, i] * b[k]
            for e in range(chain):
                for i in range(6):
                    for j in range(6):
                        total = 0.0
                        for k in range(6):
                            total += A[e, k, i] * HA[k, j]
                        H[6 * e + i, 6 * f + j] += total
    if upright:
        for i in range(6 * chain):
            for j in range(6 * chain):
                if i % 6 < 2 or j % 6 < 2:
                    H[i, j] = 1.0 if i == j else 0.0
            if i % 6 < 2:
                g[i] = 0.0
    return cost


@njit(**WHOLE)
def gauss_newton(
    T: Floats,
    matches: Packed,
    inflation2: float,
    gate2: float,
    c2: float,
    upright: bool,
    iterations: int,
    H: Floats,
    edge_H: Floats,
) -> bool:
    """Refine T (n-1, 3, 4) in place; False if the matches do not determine it.

    H (6(n-1), 6(n-1)) receives the joint information, edge_H (edges, 6, 6) each edge's own, both at the start of the
    last step.
    """
    size = 6 * T.shape[0]
    factor, step = np.empty((size, size)), np.empty(size)
    for _ in range(iterations):
        cycle_system(T, matches, inflation2, gate2, c2, upright, H, step, edge_H)
        for i in range(size):
            step[i] = -step[i]
            for j in range(i + 1):
                factor[i, j] = H[i, j]
        if not cholesky_solve(factor, step):
            return False
        largest = 0.0
        for i in range(size):
            largest = max(largest, abs(step[i]))
        if not largest < 1e3:
            return False
        for e in range(T.shape[0]):
            perturb(T[e], step[6 * e : 6 * e + 6])
        if largest < 1e-7:
            break
    return True
