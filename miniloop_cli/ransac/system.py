"""Gauss-Newton on a cycle of scans: the joint least squares of all its matches over 6 (n - 1) pose parameters.

Every edge contributes its own 6 x 6 normal equations in a perturbation xi = (w, v) of its relative pose,
x -> exp(w) x + v after the pose. A chain edge perturbs itself; the closing pose is the product of the chain, and its
perturbation is the sum of the chain's, each carried to the last scan by the adjoint of the remaining poses.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MATH = {"nnan", "ninf", "nsz", "arcp", "contract", "reassoc"}


@njit(cache=True, nogil=True, fastmath=MATH)
def compose(T: Floats) -> Floats:
    """Product T[n-2] ... T[0] of (n-1, 3, 4) poses: (3, 4)."""
    C = T[0].copy()
    for e in range(1, T.shape[0]):
        D = np.empty((3, 4))
        for i in range(3):
            for j in range(4):
                D[i, j] = T[e, i, 0] * C[0, j] + T[e, i, 1] * C[1, j] + T[e, i, 2] * C[2, j]
            D[i, 3] += T[e, i, 3]
        C = D
    return C


@njit(cache=True, nogil=True, fastmath=MATH)
def edge_system(
    T: Floats,
    P: Floats,
    Q: Floats,
    CP: Floats,
    CQ: Floats,
    first: int,
    last: int,
    inflation2: float,
    gate2: float,
    c2: float,
    H: Floats,
    g: Floats,
) -> float:
    """Normal equations of one edge; returns the robust cost.

    T (3, 4); P, Q (3, N) points (m); CP, CQ (6, N) their covariances xx xy xz yy yz zz (m^2); matches [first, last).
    The residual r = T p - q has covariance S = CQ + R CP R^T + inflation2 I; its weight is Cauchy's with scale c2
    (squared, in sigmas), and matches with |r|^2 > gate2 (m^2) are left out. H (6, 6), g (6,) are overwritten.
    """
    h = np.zeros(21)
    b = np.zeros(6)
    R00, R01, R02, t0 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    R10, R11, R12, t1 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    R20, R21, R22, t2 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    cost = 0.0
    for k in range(first, last):
        px, py, pz = P[0, k], P[1, k], P[2, k]
        x = R00 * px + R01 * py + R02 * pz + t0
        y = R10 * px + R11 * py + R12 * pz + t1
        z = R20 * px + R21 * py + R22 * pz + t2
        r0, r1, r2 = x - Q[0, k], y - Q[1, k], z - Q[2, k]
        if r0 * r0 + r1 * r1 + r2 * r2 > gate2:
            continue
        cxx, cxy, cxz, cyy, cyz, czz = CP[0, k], CP[1, k], CP[2, k], CP[3, k], CP[4, k], CP[5, k]
        # M = R CP, S = M R^T + CQ
        m00, m01, m02 = (
            R00 * cxx + R01 * cxy + R02 * cxz,
            R00 * cxy + R01 * cyy + R02 * cyz,
            R00 * cxz + R01 * cyz + R02 * czz,
        )
        m10, m11, m12 = (
            R10 * cxx + R11 * cxy + R12 * cxz,
            R10 * cxy + R11 * cyy + R12 * cyz,
            R10 * cxz + R11 * cyz + R12 * czz,
        )
        m20, m21, m22 = (
            R20 * cxx + R21 * cxy + R22 * cxz,
            R20 * cxy + R21 * cyy + R22 * cyz,
            R20 * cxz + R21 * cyz + R22 * czz,
        )
        s00 = m00 * R00 + m01 * R01 + m02 * R02 + CQ[0, k] + inflation2
        s01 = m00 * R10 + m01 * R11 + m02 * R12 + CQ[1, k]
        s02 = m00 * R20 + m01 * R21 + m02 * R22 + CQ[2, k]
        s11 = m10 * R10 + m11 * R11 + m12 * R12 + CQ[3, k] + inflation2
        s12 = m10 * R20 + m11 * R21 + m12 * R22 + CQ[4, k]
        s22 = m20 * R20 + m21 * R21 + m22 * R22 + CQ[5, k] + inflation2
        a00, a01, a02 = s11 * s22 - s12 * s12, s02 * s12 - s01 * s22, s01 * s12 - s02 * s11
        a11, a12, a22 = s00 * s22 - s02 * s02, s01 * s02 - s00 * s12, s00 * s11 - s01 * s01
        scale = 1.0 / (s00 * a00 + s01 * a01 + s02 * a02)
        u0 = scale * (a00 * r0 + a01 * r1 + a02 * r2)
        u1 = scale * (a01 * r0 + a11 * r1 + a12 * r2)
        u2 = scale * (a02 * r0 + a12 * r1 + a22 * r2)
        chi2 = r0 * u0 + r1 * u1 + r2 * u2
        cost += c2 * np.log1p(chi2 / c2)
        weight = 1.0 / (1.0 + chi2 / c2)
        scale *= weight
        w00, w01, w02, w11, w12, w22 = a00 * scale, a01 * scale, a02 * scale, a11 * scale, a12 * scale, a22 * scale
        # J = [-[x]_x | I]; rows of A = [x]_x W: (3, 3); J^T W J = [[A [x]_x^T ..., A], [A^T, W]]
        a_00, a_01, a_02 = y * w02 - z * w01, y * w12 - z * w11, y * w22 - z * w12
        a_10, a_11, a_12 = z * w00 - x * w02, z * w01 - x * w12, z * w02 - x * w22
        a_20, a_21, a_22 = x * w01 - y * w00, x * w11 - y * w01, x * w12 - y * w02
        h[0] += a_02 * y - a_01 * z
        h[1] += a_00 * z - a_02 * x
        h[2] += a_01 * x - a_00 * y
        h[3] += a_00
        h[4] += a_01
        h[5] += a_02
        h[6] += a_10 * z - a_12 * x
        h[7] += a_11 * x - a_10 * y
        h[8] += a_10
        h[9] += a_11
        h[10] += a_12
        h[11] += a_21 * x - a_20 * y
        h[12] += a_20
        h[13] += a_21
        h[14] += a_22
        h[15] += w00
        h[16] += w01
        h[17] += w02
        h[18] += w11
        h[19] += w12
        h[20] += w22
        u0, u1, u2 = u0 * weight, u1 * weight, u2 * weight
        b[0] += y * u2 - z * u1
        b[1] += z * u0 - x * u2
        b[2] += x * u1 - y * u0
        b[3] += u0
        b[4] += u1
        b[5] += u2
    k = 0
    for i in range(6):
        g[i] = b[i]
        for j in range(i, 6):
            H[i, j] = h[k]
            H[j, i] = h[k]
            k += 1
    return cost


@njit(cache=True, nogil=True)
def adjoint(T: Floats, A: Floats) -> None:
    """A (6, 6) with xi_after = A xi_before: carries a perturbation through a later pose T (3, 4)."""
    A[:, :] = 0.0
    for j in range(3):
        for i in range(3):
            A[i, j] = T[i, j]
            A[i + 3, j + 3] = T[i, j]
        A[3, j] = T[1, 3] * T[2, j] - T[2, 3] * T[1, j]
        A[4, j] = T[2, 3] * T[0, j] - T[0, 3] * T[2, j]
        A[5, j] = T[0, 3] * T[1, j] - T[1, 3] * T[0, j]


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def cholesky_solve(A: Floats, b: Floats) -> bool:
    """Solve the symmetric positive definite A x = b; A and b are overwritten, b by x. False if A is singular."""
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


@njit(cache=True, nogil=True)
def cycle_system(
    T: Floats,
    P: Floats,
    Q: Floats,
    CP: Floats,
    CQ: Floats,
    start: Ints,
    inflation2: float,
    gate2: float,
    c2: float,
    upright: bool,
    H: Floats,
    g: Floats,
    edge_H: Floats,
) -> float:
    """Normal equations H (6(n-1),)^2, g of a whole cycle; edge_H (edges, 6, 6) those of each edge; returns the cost.

    start (edges + 1,): the matches of edge e are [start[e], start[e + 1]); with more than one edge the last is the
    closing one. `upright`: rotations are about z only (known vertical), so the other two parameters are held.
    """
    chain = T.shape[0]
    H[:, :] = 0.0
    cost = 0.0
    b = np.empty(6)
    for e in range(chain):
        cost += edge_system(T[e], P, Q, CP, CQ, start[e], start[e + 1], inflation2, gate2, c2, edge_H[e], b)
        H[6 * e : 6 * e + 6, 6 * e : 6 * e + 6] = edge_H[e]
        g[6 * e : 6 * e + 6] = b
    if chain > 1:
        first, last = start[chain], start[chain + 1]
        cost += edge_system(compose(T), P, Q, CP, CQ, first, last, inflation2, gate2, c2, edge_H[chain], b)
        A = np.zeros((6, 6 * chain))
        rest = np.zeros((1, 3, 4))
        rest[0, 0, 0] = rest[0, 1, 1] = rest[0, 2, 2] = 1.0
        one = np.empty((6, 6))
        pair = np.empty((2, 3, 4))
        for e in range(chain - 1, -1, -1):
            adjoint(rest[0], one)
            A[:, 6 * e : 6 * e + 6] = one
            pair[0], pair[1] = T[e], rest[0]
            rest[0] = compose(pair)
        for i in range(6 * chain):
            for k in range(6):
                g[i] += A[k, i] * b[k]
        HA = np.zeros((6, 6 * chain))
        for i in range(6):
            for k in range(6):
                for j in range(6 * chain):
                    HA[i, j] += edge_H[chain, i, k] * A[k, j]
        for i in range(6 * chain):
            for k in range(6):
                for j in range(6 * chain):
                    H[i, j] += A[k, i] * HA[k, j]
    if upright:
        for e in range(chain):
            for i in range(6 * e, 6 * e + 2):
                H[i, :] = 0.0
                H[:, i] = 0.0
                H[i, i] = 1.0
                g[i] = 0.0
    return cost


@njit(cache=True, nogil=True)
def gauss_newton(
    T: Floats,
    P: Floats,
    Q: Floats,
    CP: Floats,
    CQ: Floats,
    start: Ints,
    inflation2: float,
    gate2: float,
    c2: float,
    upright: bool,
    iterations: int,
    edge_H: Floats,
) -> bool:
    """Refine T (n-1, 3, 4) in place; edge_H (edges, 6, 6) receives each edge's own information. False if singular."""
    size = 6 * T.shape[0]
    H, g = np.empty((size, size)), np.empty(size)
    for _ in range(iterations):
        cycle_system(T, P, Q, CP, CQ, start, inflation2, gate2, c2, upright, H, g, edge_H)
        if not cholesky_solve(H, g):
            return False
        largest = 0.0
        for e in range(T.shape[0]):
            step = -g[6 * e : 6 * e + 6]
            largest = max(largest, np.max(np.abs(step)))
            perturb(T[e], step)
        if not np.isfinite(largest) or largest > 1e3:
            return False
        if largest < 1e-7:
            break
    return True
