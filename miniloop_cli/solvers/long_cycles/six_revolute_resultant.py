"""The six equations in (a3, a4, a5) to one trigonometric polynomial in a3, its real roots, and a4, a5 at a root.

Written in the half angles (u, v) = (cos, sin)(a/2) of a4 and of a5 the six equations are forms of degree two in each;
multiplied by u5 and by v5 they are twelve linear equations in the twelve monomials of degree three in a5 and two in a4.
The determinant vanishes at a solution. Raghavan and Roth (1990) show that it has 16 roots besides a factor
(1 + tan^2(a3/2))^4, which means: as a function of a3 it is a trigonometric polynomial of degree 8, and 17 equally
spaced samples determine it, with an inverse Fourier transform as the perfectly conditioned interpolation. No half-angle
substitution of a3 is made, so 180 degrees is no special case.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS
from miniloop_cli.typing import Floats

DEGREE = 8
_SAMPLES = 2 * DEGREE + 1


_k_a = 2 * np.pi / _SAMPLES * np.arange(_SAMPLES)[:, None] * np.arange(1, DEGREE + 1)
# Row k: (1, cos, cos 2.., sin, sin 2..) at the k-th sample.
_AT_SAMPLES = np.concatenate([np.ones((_SAMPLES, 1)), np.cos(_k_a), np.sin(_k_a)], axis=1)


@njit(**OPTIONS)
def half_angle_forms(S: Floats) -> Floats:
    """The six equations of the reduced system S (14, 35), rows scaled, as forms: (3, 6, 9).

    First index: free of a3, times cos a3, times sin a3. Last index 3 i + j: the i-th of (u^2, u v, v^2) of a5 and the
    j-th of a4.
    """
    E = np.empty((3, 6, 9))
    f = np.empty(9)
    for r in range(6):
        norm2 = 0.0
        for b in range(3):
            for i in range(3):
                c = 8 + 9 * b + 3 * i
                one, cos, sin = S[8 + r, c], S[8 + r, c + 1], S[8 + r, c + 2]
                f[3 * i] = one + cos
                f[3 * i + 1] = 2 * sin
                f[3 * i + 2] = one - cos
            for j in range(3):
                E[b, r, j] = f[j] + f[3 + j]
                E[b, r, 3 + j] = 2 * f[6 + j]
                E[b, r, 6 + j] = f[j] - f[3 + j]
            for c in range(9):
                norm2 += E[b, r, c] ** 2
        scale = 1.0 / np.sqrt(norm2) if norm2 > 0.0 else 0.0
        for b in range(3):
            for c in range(9):
                E[b, r, c] *= scale
    return E


@njit(**OPTIONS)
def _at(E: Floats, cos: float, sin: float, A: Floats) -> None:
    """A (6, 9) = the forms E (3, 6, 9) at one a3."""
    for r in range(6):
        for c in range(9):
            A[r, c] = E[0, r, c] + cos * E[1, r, c] + sin * E[2, r, c]


@njit(**OPTIONS)
def _eliminate(M: Floats, steps: int) -> float:
    """Gaussian elimination with row pivots on the first `steps` columns of M; the signed product of the pivots."""
    n, m = M.shape
    det = 1.0
    for k in range(steps):
        best = k
        for r in range(k + 1, n):
            if abs(M[r, k]) > abs(M[best, k]):
                best = r
        if M[best, k] == 0.0:
            return 0.0
        if best != k:
            det = -det
            for c in range(k, m):
                M[k, c], M[best, c] = M[best, c], M[k, c]
        pivot = M[k, k]
        det *= pivot
        for r in range(k + 1, n):
            f = M[r, k] / pivot
            if f != 0.0:
                for c in range(k + 1, m):
                    M[r, c] -= f * M[k, c]
                M[r, k] = 0.0
    return det


@njit(**OPTIONS)
def _determinant(E: Floats, cos: float, sin: float, A: Floats, M: Floats) -> float:
    """Determinant of the twelve equations at one a3; A (6, 9) and M (9, 9) are scratch.

    The two shifted copies of the six equations share their first elimination, which leaves a 9 x 9 determinant.
    """
    _at(E, cos, sin, A)
    _eliminate(A, len(A) // 2)
    M[:] = 0.0
    for r in range(3):
        for c in range(6):
            M[r, c] = A[3 + r, 3 + c]
            M[6 + r, 3 + c] = A[3 + r, 3 + c]
        for c in range(9):
            M[3 + r, c] = A[r, c]
    return A[0, 0] * A[1, 1] * A[2, 2] * _eliminate(M, len(M))  # both copies permute alike


@njit(**OPTIONS)
def resultant(E: Floats) -> tuple[float, Floats]:
    """Largest sample of the determinant, and the determinant divided by it as a trigonometric polynomial in a3.

    The polynomial (17,) holds the coefficients of (1, cos k a3, sin k a3).
    """
    A = np.empty((6, 9))
    M = np.empty((9, 9))
    f = np.empty(_SAMPLES)
    largest = 0.0
    for k in range(_SAMPLES):
        f[k] = _determinant(E, _AT_SAMPLES[k, 1], _AT_SAMPLES[k, 1 + DEGREE], A, M)
        largest = max(largest, abs(f[k]))
    c = np.zeros(_SAMPLES)
    if not largest > 0.0:
        return 0.0, c
    for k in range(_SAMPLES):
        s = f[k] * 2 / (_SAMPLES * largest)
        for i in range(_SAMPLES):
            c[i] += s * _AT_SAMPLES[k, i]
    c[0] /= 2
    return largest, c


@njit(**OPTIONS)
def angles_at(E: Floats, a3: float) -> tuple[float, float]:
    """The angles (a4, a5) belonging to a root a3: the null vector of the twelve equations."""
    A = np.empty((6, 9))
    _at(E, np.cos(a3), np.sin(a3), A)
    M = np.zeros((12, 12))
    for r in range(6):
        for c in range(9):
            M[r, c] = A[r, c]
            M[6 + r, 3 + c] = A[r, c]
    column = np.arange(12)
    for k in range(11):  # complete pivoting, so that the last pivot is the smallest
        best, at_r, at_c = -1.0, k, k
        for r in range(k, 12):
            for c in range(k, 12):
                if abs(M[r, c]) > best:
                    best, at_r, at_c = abs(M[r, c]), r, c
        if best <= 0.0:
            break
        for c in range(12):
            M[k, c], M[at_r, c] = M[at_r, c], M[k, c]
        for r in range(12):
            M[r, k], M[r, at_c] = M[r, at_c], M[r, k]
        column[k], column[at_c] = column[at_c], column[k]
        for r in range(k + 1, 12):
            f = M[r, k] / M[k, k]
            for c in range(k, 12):
                M[r, c] -= f * M[k, c]
    x = np.zeros(12)
    y = np.zeros(12)
    y[11] = 1.0
    for k in range(10, -1, -1):
        if M[k, k] == 0.0:
            continue
        s = 0.0
        for c in range(k + 1, 12):
            s += M[k, c] * y[c]
        y[k] = -s / M[k, k]
    for k in range(12):
        x[column[k]] = y[k]
    # x is a rank-one table: cubes of (u5, v5) times squares of (u4, v4); the sign of x is free.
    row, col = 0, 0
    for k in range(12):
        if abs(x[k]) > abs(x[3 * row + col]):
            row, col = k // 3, k % 3
    uu, uv, vv = x[3 * row], x[3 * row + 1], x[3 * row + 2]
    sign = 1.0 if uu + vv > 0.0 else -1.0
    a4 = np.arctan2(2 * sign * uv, sign * (uu - vv))
    first = abs(x[col]) + abs(x[3 + col]) + abs(x[6 + col]) >= abs(x[3 + col]) + abs(x[6 + col]) + abs(x[9 + col])
    shift = 0 if first else 3
    uu, uv, vv = x[shift + col], x[shift + 3 + col], x[shift + 6 + col]
    sign = 1.0 if uu + vv > 0.0 else -1.0
    a5 = np.arctan2(2 * sign * uv, sign * (uu - vv))
    return a4, a5
