"""The normal equations of one edge: the least squares of its matches over a perturbation of its relative pose."""

from __future__ import annotations

import numpy as np

from miniloop_cli.ransac.matches import Packed
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats

# Sums may be reassociated, but NaN and infinity keep their meaning, as they mark a singular system.
MATH = {"nsz", "arcp", "contract", "reassoc"}


@njit(cache=True, nogil=True, error_model="numpy", fastmath=MATH)
def edge_normal_equations(
    T: Floats,
    matches: Packed,
    first: int,
    last: int,
    inflation2: float,
    gate2: float,
    c2: float,
    H: Floats,
    g: Floats,
) -> float:
    """Normal equations of one edge; returns the robust cost.

    T (3, 4); the edge's matches are the columns [first, last).
    The residual r = T p - q has covariance S = CQ + R CP R^T + inflation2 I; its weight is Cauchy's with scale c2
    (squared, in sigmas), and matches with |r|^2 > gate2 (m^2) are left out. H (6, 6), g (6,) are overwritten.
    """
    P, Q, CP, CQ = matches.P, matches.Q, matches.CP, matches.CQ
    # Sums are scalars, which stay in registers.
    h00 = h01 = h02 = h03 = h04 = h05 = h11 = h12 = h13 = h14 = h15 = 0.0
    h22 = h23 = h24 = h25 = h33 = h34 = h35 = h44 = h45 = h55 = 0.0
    g0 = g1 = g2 = g3 = g4 = g5 = 0.0
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
        h00 += a_02 * y - a_01 * z
        h01 += a_00 * z - a_02 * x
        h02 += a_01 * x - a_00 * y
        h03 += a_00
        h04 += a_01
        h05 += a_02
        h11 += a_10 * z - a_12 * x
        h12 += a_11 * x - a_10 * y
        h13 += a_10
        h14 += a_11
        h15 += a_12
        h22 += a_21 * x - a_20 * y
        h23 += a_20
        h24 += a_21
        h25 += a_22
        h33 += w00
        h34 += w01
        h35 += w02
        h44 += w11
        h45 += w12
        h55 += w22
        u0, u1, u2 = u0 * weight, u1 * weight, u2 * weight
        g0 += y * u2 - z * u1
        g1 += z * u0 - x * u2
        g2 += x * u1 - y * u0
        g3 += u0
        g4 += u1
        g5 += u2
    H[0, 0], H[0, 1], H[0, 2], H[0, 3], H[0, 4], H[0, 5] = h00, h01, h02, h03, h04, h05
    H[1, 1], H[1, 2], H[1, 3], H[1, 4], H[1, 5] = h11, h12, h13, h14, h15
    H[2, 2], H[2, 3], H[2, 4], H[2, 5] = h22, h23, h24, h25
    H[3, 3], H[3, 4], H[3, 5], H[4, 4], H[4, 5], H[5, 5] = h33, h34, h35, h44, h45, h55
    g[0], g[1], g[2], g[3], g[4], g[5] = g0, g1, g2, g3, g4, g5
    for i in range(6):
        for j in range(i):
            H[i, j] = H[j, i]
    return cost
