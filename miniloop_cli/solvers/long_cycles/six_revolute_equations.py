"""The fourteen equations of a closed chain of six revolute joints, and the six that remain after elimination.

The chain is L(a6) K6 ... L(a2) K2 L(a1) K1 = I with known rigid motions K and unknown rotations L(a) about z. The
sixth joint keeps its own axis, point by point; so the oriented axis X (a point p and a direction l) obeys

    L(a3) K3 L(a2) K2 L(a1) K1 X = K4^-1 L(a4)^-1 K5^-1 L(a5)^-1 K6^-1 X.

An oriented axis is written as 14 numbers [p, l, m = p x l, w = (p.p) l - 2 (p.l) p, p.p, p.l]. A rigid motion maps them
affinely (the first and the last block are the point's and the line's representations of the conformal group), and a
rotation about z is linear in (cos, sin). Hence both sides are bilinear in the cosines and sines of two angles each, and
a3 enters linearly: the 14 equations of Raghavan and Roth (1990, 1993), obtained here without their trigonometric
expansions. Eight monomials of (a1, a2) are eliminated by an orthogonal factorisation; six equations in (a4, a5) remain
whose coefficients are linear in (cos a3, sin a3).
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS
from miniloop_cli.typing import Floats

# Layout of the 14 numbers: p 0-2, l 3-5, m 6-8, w 9-11, p.p 12, p.l 13.
SIZE = 14


@njit(**OPTIONS)
def _move(K: Floats, X: Floats) -> None:
    """Apply the rigid motion K (3, 4) in place to the coefficient rows of X (n, 14); row 0 is the constant term."""
    R = K[:, :3]
    t = K[:, 3]
    tt = t[0] * t[0] + t[1] * t[1] + t[2] * t[2]
    v = np.empty((4, 3))
    for k in range(len(X)):
        x = X[k]
        for b in range(4):
            for i in range(3):
                v[b, i] = R[i, 0] * x[3 * b] + R[i, 1] * x[3 * b + 1] + R[i, 2] * x[3 * b + 2]
        p, l, m, w = v[0], v[1], v[2], v[3]
        tp = t[0] * p[0] + t[1] * p[1] + t[2] * p[2]
        tl = t[0] * l[0] + t[1] * l[1] + t[2] * l[2]
        pp, pl = x[12], x[13]
        one = 1.0 if k == 0 else 0.0
        for i in range(3):
            j = (i + 1) % 3
            h = (i + 2) % 3
            x[i] = p[i] + one * t[i]
            x[3 + i] = l[i]
            x[6 + i] = m[i] + t[j] * l[h] - t[h] * l[j]
            x[9 + i] = w[i] - 2 * (t[j] * m[h] - t[h] * m[j]) + tt * l[i] - 2 * (pl + tl) * t[i]
        x[12] = pp + 2 * tp + one * tt
        x[13] = pl + tl


@njit(**OPTIONS)
def _turn(X: Floats, sign: float) -> Floats:
    """Coefficients (3 n, 14) of L(sign a) X: row 3 k + (0, 1, 2) is row k of X times (1, cos a, sin a)."""
    Y = np.zeros((3 * len(X), SIZE))
    for k in range(len(X)):
        for b in range(0, 12, 3):
            Y[3 * k, b + 2] = X[k, b + 2]
            Y[3 * k + 1, b] = X[k, b]
            Y[3 * k + 1, b + 1] = X[k, b + 1]
            Y[3 * k + 2, b] = -sign * X[k, b + 1]
            Y[3 * k + 2, b + 1] = sign * X[k, b]
        Y[3 * k, 12] = X[k, 12]
        Y[3 * k, 13] = X[k, 13]
    return Y


@njit(**OPTIONS)
def invert(K: Floats) -> Floats:
    """Inverse of a rigid motion (3, 4)."""
    out = np.empty((3, 4))
    for i in range(3):
        for j in range(3):
            out[i, j] = K[j, i]
        out[i, 3] = -(K[0, i] * K[0, 3] + K[1, i] * K[1, 3] + K[2, i] * K[2, 3])
    return out


@njit(**OPTIONS)
def axis_equations(K: Floats) -> tuple[Floats, Floats]:
    """Both sides of the loop for K (6, 3, 4): coefficients (9, 14) in (a1, a2) and (9, 14) in (a5, a4).

    Row 3 i + j belongs to the i-th of (1, cos, sin) of the first named angle and the j-th of the second. The rotation
    about a3 is still missing: L(a3) left = right.
    """
    X = np.zeros((1, SIZE))
    X[0, 5] = 1.0
    _move(K[0], X)
    X = _turn(X, 1.0)
    _move(K[1], X)
    left = _turn(X, 1.0)
    _move(K[2], left)
    X = np.zeros((1, SIZE))
    X[0, 5] = 1.0
    _move(invert(K[5]), X)
    X = _turn(X, -1.0)
    _move(invert(K[4]), X)
    right = _turn(X, -1.0)
    _move(invert(K[3]), right)
    return left, right


@njit(**OPTIONS)
def reduce_equations(left: Floats, right: Floats) -> Floats:
    """Orthogonal elimination of the monomials of (a1, a2): S (14, 8 + 27).

    S = Q^T [monomials of (a1, a2) but the constant | right, free of a3 | times cos a3 | times sin a3] with the first
    eight columns upper triangular; a monomial vector of (a1, a2) times the first block equals one of (a5, a4) times the
    rest. Its last six rows are the equations in a3, a4, a5 alone.
    """
    S = np.zeros((SIZE, 35))
    for k in range(8):
        for r in range(SIZE):
            S[r, k] = left[k + 1, r]
    for k in range(9):
        for b in range(0, 12, 3):
            S[b + 2, 8 + k] = right[k, b + 2]
            S[b, 17 + k] = right[k, b]
            S[b + 1, 17 + k] = right[k, b + 1]
            S[b, 26 + k] = right[k, b + 1]
            S[b + 1, 26 + k] = -right[k, b]
        S[12, 8 + k] = right[k, 12]
        S[13, 8 + k] = right[k, 13]
    for r in range(SIZE):
        S[r, 8] -= left[0, r]
    u = np.empty(SIZE)
    y = np.empty(35)
    for k in range(8):  # Householder
        norm2 = 0.0
        for r in range(k, SIZE):
            u[r] = S[r, k]
            norm2 += u[r] * u[r]
        if norm2 == 0.0:
            continue
        norm = np.sqrt(norm2)
        if u[k] < 0.0:
            norm = -norm
        beta = 1.0 / (norm2 + abs(norm * u[k]))
        u[k] += norm
        for c in range(k, 35):
            y[c] = 0.0
        for r in range(k, SIZE):
            for c in range(k, 35):
                y[c] += u[r] * S[r, c]
        for r in range(k, SIZE):
            f = beta * u[r]
            for c in range(k, 35):
                S[r, c] -= f * y[c]
    return S


@njit(**OPTIONS)
def well_posed(S: Floats) -> bool:
    """False if the triangle S (8, 8) of the eliminated monomials is singular: axes in a special position."""
    least, most = np.inf, 0.0
    for k in range(8):
        least, most = min(least, abs(S[k, k])), max(most, abs(S[k, k]))
    return least > 1e-8 * most
