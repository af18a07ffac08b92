"""Least squares for the 5-cycle: Gauss-Newton on the four angles over all six coordinates of the two closing matches.

The octic satisfies five of the six equations and does not use the unit norm of its last angle. On noisy samples, a few
steps over all six reduce the error (measured in docs/solvers.md). On exact samples they remove rounding errors. A root
that contradicts the sixth equation moves little or not at all.
"""

from __future__ import annotations

import math

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS, Motion, Point, apply, unapply
from miniloop_cli.typing import Floats

STEPS = 2
# Longest step of an angle, as a tangent: the linearisation does not hold farther.
LONGEST_STEP = 0.5


@njit(**OPTIONS)
def equidistant(p1: Point, p2: Point, q1: Point, q2: Point) -> tuple[Point, Point, Point, Point]:
    """Both pairs, stretched about their midpoints to their mean length, as a rigid motion keeps lengths."""
    x, y, z, u, v, w = p2[0] - p1[0], p2[1] - p1[1], p2[2] - p1[2], q2[0] - q1[0], q2[1] - q1[1], q2[2] - q1[2]
    p, q = math.sqrt(x * x + y * y + z * z), math.sqrt(u * u + v * v + w * w)
    a, b = 0.25 * (p - q) / p, 0.25 * (q - p) / q
    return (
        (p1[0] + a * x, p1[1] + a * y, p1[2] + a * z),
        (p2[0] - a * x, p2[1] - a * y, p2[2] - a * z),
        (q1[0] + b * u, q1[1] + b * v, q1[2] + b * w),
        (q2[0] - b * u, q2[1] - b * v, q2[2] - b * w),
    )


@njit(**OPTIONS)
def _closing_error(
    K2: Motion, K3: Motion, K4: Motion, p: Point, q: Point, angles: Floats, J: Floats, r: Floats, i: int
) -> None:
    """Rows i .. i+2 of the error r of one closing match (m, in the frame before the turn g) and of its derivative J.

    angles: cos a, sin a, cos b, sin b, cos g, sin g, cos d, sin d.
    """
    ca, sa, cb, sb = angles[0], angles[1], angles[2], angles[3]
    cg, sg, cd, sd = angles[4], angles[5], angles[6], angles[7]
    px, py = ca * p[0] - sa * p[1], sa * p[0] + ca * p[1]
    vx, vy, vz = apply(K2, px, py, p[2])
    wx, wy = cb * vx - sb * vy, sb * vx + cb * vy
    x, y, z = apply(K3, wx, wy, vz)
    qx, qy = cd * q[0] + sd * q[1], cd * q[1] - sd * q[0]
    ex, ey, ez = unapply(K4, qx, qy, q[2])
    fx, fy = cg * ex + sg * ey, cg * ey - sg * ex
    r[i], r[i + 1], r[i + 2] = x - fx, y - fy, z - ez
    # A turn about z moves (x, y, z) along (-y, x, 0).
    ax, ay, az = K2[1] * px - K2[0] * py, K2[4] * px - K2[3] * py, K2[7] * px - K2[6] * py
    ax, ay = cb * ax - sb * ay, sb * ax + cb * ay
    dx, dy, dz = K4[3] * qx - K4[0] * qy, K4[4] * qx - K4[1] * qy, K4[5] * qx - K4[2] * qy
    for j in range(3):
        J[i + j, 0] = K3[3 * j] * ax + K3[3 * j + 1] * ay + K3[3 * j + 2] * az
        J[i + j, 1] = K3[3 * j + 1] * wx - K3[3 * j] * wy
    J[i, 2], J[i + 1, 2], J[i + 2, 2] = -fy, fx, 0.0
    J[i, 3], J[i + 1, 3], J[i + 2, 3] = cg * dx + sg * dy, cg * dy - sg * dx, dz


@njit(**OPTIONS)
def _least_squares(J: Floats, r: Floats, A: Floats) -> None:
    """r[:4] becomes the step -(J^T J)^-1 J^T r, J (6, 4), r (6,), A (4, 5) scratch; damped where J^T J is singular."""
    trace = 0.0
    for i in range(4):
        for j in range(i + 1):
            value = 0.0
            for k in range(6):
                value += J[k, i] * J[k, j]
            A[i, j] = value
        value = 0.0
        for k in range(6):
            value += J[k, i] * r[k]
        A[i, 4] = -value
        trace += A[i, i]
    for i in range(4):  # Cholesky, L in the lower triangle, then both substitutions
        for j in range(i + 1):
            value = A[i, j] + (1e-13 * trace if i == j else 0.0)
            for k in range(j):
                value -= A[i, k] * A[j, k]
            A[i, j] = math.sqrt(max(value, 1e-14 * trace)) if i == j else value / A[j, j]
    for i in range(4):
        for k in range(i):
            A[i, 4] -= A[i, k] * A[k, 4]
        A[i, 4] /= A[i, i]
    for i in range(3, -1, -1):
        for k in range(i + 1, 4):
            A[i, 4] -= A[k, i] * A[k, 4]
        A[i, 4] /= A[i, i]
        r[i] = A[i, 4]


@njit(**OPTIONS)
def close_loop(
    K2: Motion, K3: Motion, K4: Motion, p: tuple[Point, Point], q: tuple[Point, Point], angles: Floats, work: Floats
) -> float:
    """Improve the angles (8,), see `_closing_error`; work (>= 12, >= 8): scratch; returns the squares (m^2) left."""
    J, A, r, before = work[0:6], work[6:10], work[10], work[11]
    least = math.inf
    for step in range(STEPS + 1):
        for match in range(2):
            _closing_error(K2, K3, K4, p[match], q[match], angles, J, r, 3 * match)
        residual = 0.0
        for i in range(6):
            residual += r[i] * r[i]
        if not residual < least:
            for i in range(8):
                angles[i] = before[i]
            break
        least = residual
        if step == STEPS:
            break
        _least_squares(J, r, A)
        largest = 0.0
        for i in range(4):
            c, s = angles[2 * i], angles[2 * i + 1]
            before[2 * i], before[2 * i + 1] = c, s
            t = min(max(r[i], -LONGEST_STEP), LONGEST_STEP)
            norm = 1 / math.sqrt(1 + t * t)
            angles[2 * i], angles[2 * i + 1] = (c - t * s) * norm, (s + t * c) * norm
            largest = max(largest, abs(t))
        if largest < 1e-10:
            break
    return least
