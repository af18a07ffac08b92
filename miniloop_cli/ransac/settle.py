"""After the search: refine on all matches with their own noise, count the inliers again, refit on them alone."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from miniloop_cli.ransac.system import adjoint, compose, cycle_system, gauss_newton

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CAUCHY2 = 9.0  # robust scale (squared, in sigmas) of both fits
STEPS = 8


@njit(cache=True, nogil=True)
def mahalanobis2(T: Floats, P: Floats, Q: Floats, CP: Floats, CQ: Floats, first: int, last: int, out: Floats) -> None:
    """out[first:last] = r^T S^-1 r of each match, r = T p - q, S = CQ + R CP R^T; infinite where S is singular."""
    R, S, C = np.ascontiguousarray(T[:, :3]), np.empty((3, 3)), np.empty((3, 3))
    for k in range(first, last):
        C[0, 0], C[0, 1], C[0, 2], C[1, 1], C[1, 2], C[2, 2] = (
            CP[0, k],
            CP[1, k],
            CP[2, k],
            CP[3, k],
            CP[4, k],
            CP[5, k],
        )
        C[1, 0], C[2, 0], C[2, 1] = C[0, 1], C[0, 2], C[1, 2]
        r = np.empty(3)
        for i in range(3):
            r[i] = R[i, 0] * P[0, k] + R[i, 1] * P[1, k] + R[i, 2] * P[2, k] + T[i, 3] - Q[i, k]
            for j in range(3):
                S[i, j] = 0.0
                for a in range(3):
                    for b in range(3):
                        S[i, j] += R[i, a] * C[a, b] * R[j, b]
        S[0, 0] += CQ[0, k]
        S[0, 1] += CQ[1, k]
        S[0, 2] += CQ[2, k]
        S[1, 1] += CQ[3, k]
        S[1, 2] += CQ[4, k]
        S[2, 2] += CQ[5, k]
        a00, a01 = S[1, 1] * S[2, 2] - S[1, 2] ** 2, S[0, 2] * S[1, 2] - S[0, 1] * S[2, 2]
        a02, a11 = S[0, 1] * S[1, 2] - S[0, 2] * S[1, 1], S[0, 0] * S[2, 2] - S[0, 2] ** 2
        a12, a22 = S[0, 1] * S[0, 2] - S[0, 0] * S[1, 2], S[0, 0] * S[1, 1] - S[0, 1] ** 2
        det = S[0, 0] * a00 + S[0, 1] * a01 + S[0, 2] * a02
        if det > 0:
            square = a00 * r[0] ** 2 + a11 * r[1] ** 2 + a22 * r[2] ** 2
            square += 2 * (a01 * r[0] * r[1] + a02 * r[0] * r[2] + a12 * r[1] * r[2])
            out[k] = square / det
        else:
            out[k] = np.inf


@njit(cache=True, nogil=True)
def settle(
    T: Floats, P: Floats, Q: Floats, CP: Floats, CQ: Floats, start: Ints, gate2: float, chi2_gate: float, upright: bool
) -> tuple[bool, Floats, Floats, Floats]:
    """Robust joint refinement of T (n-1, 3, 4), in place, and what each edge's matches say to it.

    Returns (sound, chi2 (N,), information (edges, 6, 6) of each edge from its own inliers, covariance (edges, 6, 6)
    of each edge's pose in the joint estimate). `gate2` (m^2): matches farther off are ignored from the start.
    """
    chain, edges = T.shape[0], start.shape[0] - 1
    chi2 = np.empty(P.shape[1])
    information, covariance = np.zeros((edges, 6, 6)), np.zeros((edges, 6, 6))
    if not gauss_newton(T, P, Q, CP, CQ, start, 0.0, gate2, CAUCHY2, upright, STEPS, information):
        return False, chi2, information, covariance
    for _ in range(2):
        for e in range(edges):
            mahalanobis2(T[e] if e < chain else compose(T), P, Q, CP, CQ, start[e], start[e + 1], chi2)
        kept, kept_start = np.empty(P.shape[1], np.int64), np.zeros(edges + 1, np.int64)
        count = 0
        for e in range(edges):
            for k in range(start[e], start[e + 1]):
                if chi2[k] < chi2_gate:
                    kept[count] = k
                    count += 1
            kept_start[e + 1] = count
        rows = kept[:count]
        p, q, cp, cq = P[:, rows], Q[:, rows], CP[:, rows], CQ[:, rows]
        if not gauss_newton(T, p, q, cp, cq, kept_start, 0.0, np.inf, CAUCHY2, upright, STEPS, information):
            return False, chi2, information, covariance
    for e in range(edges):
        mahalanobis2(T[e] if e < chain else compose(T), P, Q, CP, CQ, start[e], start[e + 1], chi2)
    size = 6 * chain
    H, g = np.empty((size, size)), np.empty(size)
    cycle_system(T, p, q, cp, cq, kept_start, 0.0, np.inf, CAUCHY2, upright, H, g, information)
    joint = np.linalg.inv(H)
    for e in range(chain):
        covariance[e] = joint[6 * e : 6 * e + 6, 6 * e : 6 * e + 6]
    if edges > chain:
        A, one = np.zeros((6, size)), np.empty((6, 6))
        rest, pair = np.zeros((3, 4)), np.empty((2, 3, 4))
        rest[0, 0] = rest[1, 1] = rest[2, 2] = 1.0
        for e in range(chain - 1, -1, -1):
            adjoint(rest, one)
            A[:, 6 * e : 6 * e + 6] = one
            pair[0], pair[1] = T[e], rest
            rest = compose(pair)
        covariance[chain] = A @ joint @ A.T
    return True, chi2, information, covariance
