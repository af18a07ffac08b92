"""Closing error of a chain of six revolute joints, its derivative, and the Newton iteration that drives it to zero."""

from __future__ import annotations

import math

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS
from miniloop_cli.typing import Floats


@njit(**OPTIONS)
def closing_error(K: Floats, a: Floats, J: Floats, e: Floats) -> tuple[float, float]:
    """Closing error e (6,) = (rotation, translation) of L(a6) K6 ... L(a1) K1 and its derivative J (6, 6).

    K (6, 3, 4), a (6,) rad. The rotation enters as axis times sine, or the axis itself beyond 90 degrees.
    Returns the largest absolute component, and the value of a6 that would close the chain if the others are right.
    """
    R, Q, t = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for i in range(3):
        t[i] = 0.0
        for j in range(3):
            R[i, j] = 1.0 if i == j else 0.0
    for k in range(5, -1, -1):
        # Column k: the twist of axis k seen from the end of the chain, direction R z through t.
        x, y, z = R[0, 2], R[1, 2], R[2, 2]
        J[0, k], J[1, k], J[2, k] = x, y, z
        J[3, k], J[4, k], J[5, k] = t[1] * z - t[2] * y, t[2] * x - t[0] * z, t[0] * y - t[1] * x
        c, s = math.cos(a[k]), math.sin(a[k])
        for i in range(3):  # (R, t) <- (R, t) L(a_k) K_k
            x, y, z = R[i, 0] * c + R[i, 1] * s, R[i, 1] * c - R[i, 0] * s, R[i, 2]
            for j in range(3):
                Q[i, j] = x * K[k, 0, j] + y * K[k, 1, j] + z * K[k, 2, j]
            t[i] += x * K[k, 0, 3] + y * K[k, 1, 3] + z * K[k, 2, 3]
        for i in range(3):
            for j in range(3):
                R[i, j] = Q[i, j]
    e[0], e[1], e[2] = 0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1])
    if R[0, 0] + R[1, 1] + R[2, 2] < 1.0:
        scale = 1.0 / math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2] + 1e-300)
        for i in range(3):
            e[i] *= scale
    largest = 0.0
    for i in range(3):
        e[3 + i] = t[i]
        largest = max(largest, abs(e[i]), abs(t[i]))
    return largest, a[5] + math.atan2(R[0, 1] - R[1, 0], R[0, 0] + R[1, 1])


@njit(**OPTIONS)
def solve_in_place(M: Floats, x: Floats) -> float:
    """Solve M (6, 6) y = x by elimination with complete pivoting; y replaces x.

    Returns the ratio of the last pivot to the first; if that is zero, nothing is solved.
    """
    order = np.arange(6)
    first, last = 0.0, 0.0
    for k in range(6):
        best, at_r, at_c = -1.0, k, k
        for r in range(k, 6):
            for c in range(k, 6):
                if abs(M[r, c]) > best:
                    best, at_r, at_c = abs(M[r, c]), r, c
        if k == 0:
            first = best
        last = best
        if not best > 0.0:
            return 0.0
        for c in range(6):
            M[k, c], M[at_r, c] = M[at_r, c], M[k, c]
        x[k], x[at_r] = x[at_r], x[k]
        for r in range(6):
            M[r, k], M[r, at_c] = M[r, at_c], M[r, k]
        order[k], order[at_c] = order[at_c], order[k]
        for r in range(k + 1, 6):
            f = M[r, k] / M[k, k]
            for c in range(k + 1, 6):
                M[r, c] -= f * M[k, c]
            x[r] -= f * x[k]
    y = np.empty(6)
    for k in range(5, -1, -1):
        s = x[k]
        for c in range(k + 1, 6):
            s -= M[k, c] * y[c]
        y[k] = s / M[k, k]
    for k in range(6):
        x[order[k]] = y[k]
    return last / first


@njit(**OPTIONS)
def close(K: Floats, a: Floats, iterations: int, tight: float) -> tuple[float, float]:
    """Newton's method on the angles a (6,), in place, damped (Levenberg, Marquardt) once a step does not help.

    Stops below the error `tight`. Returns the closing error reached, and the ratio of pivots of its derivative: near
    zero where solutions coincide or the chain can move.
    """
    J = np.empty((6, 6))
    N = np.empty((6, 6))
    e = np.empty(6)
    g = np.empty(6)
    kept = np.empty(6)
    kept_J = np.empty((6, 6))
    kept_e = np.empty(6)
    best, ratio, damping = np.inf, 0.0, 0.0
    for _ in range(iterations):
        error, _ = closing_error(K, a, J, e)
        if error < best:
            best = error
            damping *= 0.1
            for i in range(6):
                kept[i], kept_e[i] = a[i], e[i]
                for j in range(6):
                    kept_J[i, j] = J[i, j]
        else:
            damping = max(10.0 * damping, 1e-4)
        for i in range(6):
            g[i] = kept_e[i]
            for j in range(6):
                N[i, j] = kept_J[i, j]
        if damping < 1e-6:
            ratio = solve_in_place(N, g)
        else:
            for i in range(6):
                v = 0.0
                for k in range(6):
                    v += kept_J[k, i] * kept_e[k]
                g[i] = v
                for j in range(6):
                    v = damping if i == j else 0.0
                    for k in range(6):
                        v += kept_J[k, i] * kept_J[k, j]
                    N[i, j] = v
            solve_in_place(N, g)
        if best < tight or damping > 1e3:
            break
        longest = 0.0
        for i in range(6):
            longest = max(longest, abs(g[i]))
        step = min(1.0, 0.5 / longest) if longest > 0.0 else 0.0
        for i in range(6):
            a[i] = kept[i] - step * g[i]
    for i in range(6):
        a[i] = kept[i]
    return best, ratio
