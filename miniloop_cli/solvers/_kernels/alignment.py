"""Predefined transformations: two matches of an edge leave one rotation, about the axis through them (paper, sec. 2.1).

H moves scan e, G moves scan e+1, so that the two matched points lie on the z axis, symmetric about the origin; then
T_e = G^-1 L(theta) H with L a rotation about z. The paper puts the origin into the first point. The midpoint is
equally valid and shares the error between two noisy points (measured in docs/solvers.md).

A frame is a row of 12 floats: the axes x, y, z of the rotation into it, then its origin. A rigid motion K is a tuple of
12 floats: rotation row by row, then translation. Rotations about z are unit complex numbers (c, s).
numba compiles a function again for each literal number in a call. Frames are therefore rows of arrays, indexed before
the call, and no function here takes an index that callers would write as a literal.
"""

from __future__ import annotations

import math
from typing import Any

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.typing import Floats

Motion = tuple[float, ...]
Point = tuple[float, float, float]
# No fast math: functions that call each other are compiled in several copies, which would then differ in the last
# digits; and degenerate samples are recognised by NaN and infinity.
OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
# A baseline shorter than this share of the coordinates gives no axis: its direction would be rounding error.
SHORTEST_BASELINE = 1e-10
# Below this a length is zero and gives no direction.
TINY = 1e-150


@njit(**OPTIONS)
def frame_through(first: Floats, second: Floats, frame: Floats) -> bool:
    """frame (12,) of the axis through points first (3,), second (3,): origin in their midpoint, z towards the second.

    False if the points (nearly) coincide or are not finite. The basis is Duff et al., "Building an orthonormal basis,
    revisited", JCGT 2017: no branch, no square root.
    """
    x, y, z = second[0] - first[0], second[1] - first[1], second[2] - first[2]
    ox, oy, oz = first[0] + 0.5 * x, first[1] + 0.5 * y, first[2] + 0.5 * z
    length = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / length
    x, y, z = x * scale, y * scale, z * scale
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    frame[0], frame[1], frame[2] = 1 + sign * x * x * a, sign * b, -sign * x
    frame[3], frame[4], frame[5] = b, sign + y * y * a, -y
    frame[6], frame[7], frame[8] = x, y, z
    frame[9], frame[10], frame[11] = ox, oy, oz
    return TINY < length < math.inf and length > SHORTEST_BASELINE * (abs(ox) + abs(oy) + abs(oz))


@njit(**OPTIONS)
def edge_frames(p: Floats, q: Floats, H: Floats, G: Floats) -> bool:
    """Frames H, G (edges, 12) of the axes through the two matches of each edge, in its first scan and in its second.

    p, q (k, 3) matches, k >= 2 edges. False if an edge has no axis.
    """
    good = True
    for e in range(H.shape[0]):
        good &= frame_through(p[2 * e], p[2 * e + 1], H[e])
        good &= frame_through(q[2 * e], q[2 * e + 1], G[e])
    return good


@njit(**OPTIONS)
def aligned(frame: Floats, point: Floats) -> Point:
    """Coordinates of a point (3,) in `frame` (12,)."""
    x, y, z = point[0] - frame[9], point[1] - frame[10], point[2] - frame[11]
    return (
        frame[0] * x + frame[1] * y + frame[2] * z,
        frame[3] * x + frame[4] * y + frame[5] * z,
        frame[6] * x + frame[7] * y + frame[8] * z,
    )


@njit(**OPTIONS)
def off_axis(frame: Floats, point: Point) -> bool:
    """Whether a point in the aligned coordinates of frame (12,) is far enough from the axis for a turn to show."""
    radius2 = point[0] * point[0] + point[1] * point[1]
    size2 = point[2] * point[2] + frame[9] * frame[9] + frame[10] * frame[10] + frame[11] * frame[11]
    return radius2 > SHORTEST_BASELINE * SHORTEST_BASELINE * size2 and radius2 < math.inf


@njit(**OPTIONS)
def joint(H: Floats, G: Floats) -> Motion:
    """K = H G^-1 of H (12,), G (12,): from the axis that a scan is entered by (G) to the one it is left by (H)."""
    x, y, z = G[9] - H[9], G[10] - H[10], G[11] - H[11]
    return (
        H[0] * G[0] + H[1] * G[1] + H[2] * G[2],
        H[0] * G[3] + H[1] * G[4] + H[2] * G[5],
        H[0] * G[6] + H[1] * G[7] + H[2] * G[8],
        H[3] * G[0] + H[4] * G[1] + H[5] * G[2],
        H[3] * G[3] + H[4] * G[4] + H[5] * G[5],
        H[3] * G[6] + H[4] * G[7] + H[5] * G[8],
        H[6] * G[0] + H[7] * G[1] + H[8] * G[2],
        H[6] * G[3] + H[7] * G[4] + H[8] * G[5],
        H[6] * G[6] + H[7] * G[7] + H[8] * G[8],
        H[0] * x + H[1] * y + H[2] * z,
        H[3] * x + H[4] * y + H[5] * z,
        H[6] * x + H[7] * y + H[8] * z,
    )


@njit(**OPTIONS)
def backwards(K: Motion) -> Motion:
    """The inverse of the motion K."""
    x, y, z = back_translation(K)
    return K[0], K[3], K[6], K[1], K[4], K[7], K[2], K[5], K[8], -x, -y, -z


@njit(**OPTIONS)
def crossing(K: Motion) -> float:
    """Triple product of the two axes that K links and their distance vector over its length, -1 to 1.

    Zero if the axes are parallel or meet: then the z row and the norm of K x give the same equation for x.
    """
    u = back_translation(K)
    length = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    return (K[6] * u[1] - K[7] * u[0]) / length if length > TINY else 0.0


@njit(**OPTIONS)
def turned(K: Motion, p: Point) -> tuple[Point, Point, Point]:
    """Coordinates x, y, z of K L(a) p, each as coefficients of (1, cos a, sin a)."""
    return (
        (K[2] * p[2] + K[9], K[0] * p[0] + K[1] * p[1], K[1] * p[0] - K[0] * p[1]),
        (K[5] * p[2] + K[10], K[3] * p[0] + K[4] * p[1], K[4] * p[0] - K[3] * p[1]),
        (K[8] * p[2] + K[11], K[6] * p[0] + K[7] * p[1], K[7] * p[0] - K[6] * p[1]),
    )


@njit(**OPTIONS)
def back_translation(K: Motion) -> Point:
    """u = R^T t of K: |K x|^2 = |x|^2 + |t|^2 + 2 u.x, which makes norms linear in a cosine and a sine."""
    return (
        K[0] * K[9] + K[3] * K[10] + K[6] * K[11],
        K[1] * K[9] + K[4] * K[10] + K[7] * K[11],
        K[2] * K[9] + K[5] * K[10] + K[8] * K[11],
    )


@njit(**OPTIONS)
def turned_norm(u: Point, t2: float, p: Point) -> Point:
    """Half of |K L(a) p|^2 as coefficients of (1, cos a, sin a); u = R^T t and t2 = |t|^2 of K."""
    half = 0.5 * (p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + t2)
    return half + u[2] * p[2], u[0] * p[0] + u[1] * p[1], u[1] * p[0] - u[0] * p[1]


@njit(**OPTIONS)
def at(f: Point, c: float, s: float) -> float:
    """Value of f, coefficients of (1, cos, sin), at an angle."""
    return f[0] + f[1] * c + f[2] * s


@njit(**OPTIONS)
def apply(K: Motion, x: float, y: float, z: float) -> Point:
    """K (x, y, z)."""
    return (
        K[0] * x + K[1] * y + K[2] * z + K[9],
        K[3] * x + K[4] * y + K[5] * z + K[10],
        K[6] * x + K[7] * y + K[8] * z + K[11],
    )


@njit(**OPTIONS)
def unapply(K: Motion, x: float, y: float, z: float) -> Point:
    """K^-1 (x, y, z)."""
    x, y, z = x - K[9], y - K[10], z - K[11]
    return K[0] * x + K[3] * y + K[6] * z, K[1] * x + K[4] * y + K[7] * z, K[2] * x + K[5] * y + K[8] * z


@njit(**OPTIONS)
def unit(z: complex) -> tuple[complex, bool]:
    """z / |z|, a turn about z as a complex number; False if z has no direction."""
    norm = math.sqrt(z.real * z.real + z.imag * z.imag)
    scale = 1 / norm
    return complex(z.real * scale, z.imag * scale), TINY < norm < math.inf


@njit(**OPTIONS)
def write_edge(T: Floats, H: Floats, G: Floats, cos: float, sin: float) -> None:
    """T (3, 4) = [R | t] of G^-1 L(angle) H."""
    for k in range(3):
        gx, gy, gz = G[k], G[3 + k], G[6 + k]
        a, b = cos * gx + sin * gy, cos * gy - sin * gx
        rx, ry, rz = (
            a * H[0] + b * H[3] + gz * H[6],
            a * H[1] + b * H[4] + gz * H[7],
            a * H[2] + b * H[5] + gz * H[8],
        )
        T[k, 0], T[k, 1], T[k, 2] = rx, ry, rz
        T[k, 3] = G[9 + k] - (rx * H[9] + ry * H[10] + rz * H[11])
