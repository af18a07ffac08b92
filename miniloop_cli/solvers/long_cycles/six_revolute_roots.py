"""Real roots of a trigonometric polynomial of degree 8, all of them, by Descartes' rule in the Bernstein basis.

f(a) = c0 + sum_k (c_k cos k a + c_{8+k} sin k a) is a form of degree 16 in (cos, sin)(a/2). On an arc between two half
angles, with the point on the chord between them as the parameter, it is a polynomial of degree 16 with the same roots.
The sign changes of its Bernstein coefficients exceed the number of roots in the arc by an even number: none means no
root, one means one root, otherwise the arc is halved (de Casteljau). A count of two or more that falls to zero as the
arc is halved indicates a complex pair nearby.
"""

from __future__ import annotations

import math

import numpy as np

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS
from miniloop_cli.typing import Floats

DEGREE = 8
MAX_ROOTS = 24
_ORDER = 2 * DEGREE
_ARCS = 4
_START_RAD = 0.2718  # arcs do not end at the round angles of made-up examples
_ARC_RAD = 2 * np.pi / _ARCS
_DEPTH = 22  # halvings: pi / 2 to 4e-7 rad


def _bernstein_matrices() -> Floats:
    """(arcs, 17, 17) maps from the coefficients c to the Bernstein coefficients on each arc."""
    W = np.empty((_ARCS, _ORDER + 1, _ORDER + 1))
    binomials = np.array([1.0])
    for _ in range(_ORDER):
        binomials = np.convolve(binomials, [1.0, 1.0])
    for arc in range(_ARCS):
        ends = np.exp(0.5j * (_START_RAD + _ARC_RAD * np.array([arc, arc + 1])))
        for k in range(DEGREE + 1):
            # e^{i k a} is z^(8+k) conj(z)^(8-k), z running linearly along the chord.
            product = np.array([1.0 + 0j])
            for i in range(_ORDER):
                product = np.convolve(product, ends if i < DEGREE + k else ends.conj())
            W[arc, :, k] = product.real / binomials
            if k:
                W[arc, :, DEGREE + k] = product.imag / binomials
    for arc in range(_ARCS):  # neighbours agree to the last bit on the value at their common end
        W[(arc + 1) % _ARCS, 0] = W[arc, -1]
    return W


_TO_BERNSTEIN = _bernstein_matrices()


@njit(**OPTIONS)
def _sign_changes(b: Floats) -> int:
    n = 0
    for i in range(_ORDER):
        if (b[i] > 0.0) != (b[i + 1] > 0.0):
            n += 1
    return n


@njit(**OPTIONS)
def _halve(left: Floats, right: Floats) -> None:
    """de Casteljau at the middle: `right` holds the coefficients on entry and those of its right half after."""
    left[0] = right[0]
    for k in range(1, _ORDER + 1):
        for i in range(_ORDER + 1 - k):
            right[i] = 0.5 * (right[i] + right[i + 1])
        left[k] = right[0]


@njit(**OPTIONS)
def _evaluate(c: Floats, a: float) -> tuple[float, float, float]:
    """Value, slope and curvature at the angle a (rad)."""
    x, y = math.cos(a), math.sin(a)
    ck, sk = 1.0, 0.0
    f, d, h = c[0], 0.0, 0.0
    for k in range(1, DEGREE + 1):
        ck, sk = ck * x - sk * y, sk * x + ck * y
        wave = c[k] * ck + c[k + DEGREE] * sk
        f += wave
        d += k * (c[k + DEGREE] * ck - c[k] * sk)
        h -= k * k * wave
    return f, d, h


@njit(**OPTIONS)
def _bracketed_root(c: Floats, lo: float, hi: float, rising: bool) -> float:
    """The root inside a bracket: Newton guarded by bisection."""
    a = 0.5 * (lo + hi)
    for _ in range(60):
        f, d, _ = _evaluate(c, a)
        if (f > 0.0) == rising:
            hi = a
        else:
            lo = a
        step = a - f / d if d != 0.0 else lo
        if not lo < step < hi:
            step = 0.5 * (lo + hi)
        if abs(step - a) < 1e-13:
            return step
        a = step
    return a


@njit(**OPTIONS)
def _nearly_real(c: Floats, lo: float, hi: float) -> tuple[float, float]:
    """Real part of the complex pair near the arc and its imaginary part: f is nearly a parabola f0 + f2 (a - a0)^2 / 2.

    The imaginary part is infinite if there is no such pair.
    """
    a = 0.5 * (lo + hi)
    for _ in range(8):
        f, d, h = _evaluate(c, a)
        a -= d / h
        if not abs(2 * a - lo - hi) < 2 * (hi - lo):
            return a, math.inf
    return a, math.sqrt(2 * f / h) if f / h > 0.0 else math.inf


@njit(**OPTIONS)
def _angle(arc: int, s: float) -> float:
    """Angle (rad) at the fraction s of the chord of an arc."""
    half = 0.25 * _ARC_RAD
    return _START_RAD + _ARC_RAD * (arc + 0.5) + 2 * math.atan((2 * s - 1) * math.tan(half))


@njit(**OPTIONS)
def real_roots(c: Floats, near_rad: float, out: Floats) -> int:
    """Angles (rad) at which the trigonometric polynomial c (17,) vanishes, and those of nearly real pairs.

    A complex pair less than near_rad (at most some 0.05) from the real axis gives its real part, rarely twice. Row k of
    out (MAX_ROOTS, 2): the angle, and the imaginary part of a pair, zero for a real root. Returns the number of rows.
    """
    b = np.empty((_DEPTH + 2, _ORDER + 1))
    start = np.empty(_DEPTH + 2)
    level = np.empty(_DEPTH + 2, np.int64)
    n = 0
    for arc in range(_ARCS):
        for i in range(_ORDER + 1):
            v = 0.0
            for k in range(_ORDER + 1):
                v += _TO_BERNSTEIN[arc, i, k] * c[k]
            b[0, i] = v
        start[0], level[0] = 0.0, 0
        top = 0
        while top >= 0:
            changes = _sign_changes(b[top])
            depth = level[top]
            s = start[top]
            width = 0.5**depth
            if n >= MAX_ROOTS or changes == 0:
                top -= 1
            elif changes == 1:
                rising = b[top, _ORDER] > 0.0
                out[n, 1] = 0.0
                out[n, 0] = _bracketed_root(c, _angle(arc, s), _angle(arc, s + width), rising)
                n += 1
                top -= 1
            elif depth == _DEPTH:
                out[n, 0], out[n, 1] = _angle(arc, s + 0.5 * width), width * _ARC_RAD
                n += 1
                top -= 1
            else:
                half = 0.5 * width
                _halve(b[top + 1], b[top])
                start[top + 1], level[top + 1] = s, depth + 1
                start[top], level[top] = s + half, depth + 1
                if _sign_changes(b[top]) + _sign_changes(b[top + 1]) == 0:
                    angle, imaginary = _nearly_real(c, _angle(arc, s), _angle(arc, s + width))
                    if imaginary < near_rad:
                        out[n, 0], out[n, 1] = angle, imaginary
                        n += 1
                    top -= 1
                else:
                    top += 1
        # A pair near the end of an arc is not found from either side.
        end = _angle(arc, 1.0)
        angle, imaginary = _nearly_real(c, end - near_rad, end + near_rad)
        if imaginary < near_rad and abs(angle - end) < imaginary and n < MAX_ROOTS:
            out[n, 0], out[n, 1] = angle, imaginary
            n += 1
    return n
