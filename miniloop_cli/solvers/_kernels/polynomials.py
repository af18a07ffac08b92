"""Real roots of trigonometric polynomials: f(a) = sum_k C_k cos(k a) + S_k sin(k a), k = 0..d, roots as (cos a, sin a).

This equals a polynomial of degree 2d in tan(a/2), except that on the circle no root lies at infinity.
1. The circle is cut into two halves at a diameter whose ends are far from roots (largest |f| among samples).
2. On each half t = tan(a/2), measured from its middle, runs over [-1, 1], and F(t) = (1 + t^2)^d f is well conditioned.
3. The zeros of F' are isolated by Descartes' rule: the sign changes of the Bernstein coefficients bound the number of
   zeros on an interval; halve it (de Casteljau) while there is more than one. Newton within brackets refines them.
4. Between them F is monotone: each change of sign holds exactly one root, refined likewise. No root is missed
   and double roots need no special case.
5. Where |F| has a positive minimum, F is nearly F0 + F2 (t - t0)^2 / 2: a complex pair with real part t0 and
   imaginary part sqrt(2 F0 / F2). Below `nearly_real` (rad) t0 is reported: noise splits a double root in this way.

Source: Descartes' rule in Bernstein form as in Rouillier & Zimmermann, "Efficient isolation of polynomial's real
roots", 2004.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import polynomial

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS
from miniloop_cli.typing import Floats

# Largest imaginary part, in radians, of a root that is still reported by its real part.
NEARLY_REAL = 0.2
# Intervals of F' are halved at most so often: on the last ones F varies by less than rounding.
DEPTH = 18
# Rows of 12 numbers that one call of roots_on_circle works in.
ROWS = DEPTH + 10
SAMPLES = 16
# A Newton step so short is the last: the next one would have the square of its length.
CONVERGED = 1e-11
TURN = np.exp(2j * np.pi * np.arange(SAMPLES) / SAMPLES)
COS, SIN = TURN.real.copy(), TURN.imag.copy()


def _tables(d: int) -> tuple[Floats, Floats]:
    """Fourier coefficients (C_0, C_1, S_1, C_2 ...) to the 2d+1 powers of t, and to Bernstein coefficients on [-1, 1].

    From e^{ia} = (1 + it) / (1 - it): (1 + t^2)^d e^{ika} = (1 + it)^(d+k) (1 - it)^(d-k).
    """
    n = 2 * d
    powers = np.zeros((n + 1, n + 1))
    for k in range(d + 1):
        term = polynomial.polymul(polynomial.polypow([1, 1j], d + k), polynomial.polypow([1, -1j], d - k))
        powers[:, max(0, 2 * k - 1)] = term.real
        if k:
            powers[:, 2 * k] = term.imag
    # t = 2u - 1, then u^j = sum_i C(i, j) / C(n, j) B_i.
    shift = np.array([np.pad(polynomial.polypow([-1, 2], j), (0, n - j)) for j in range(n + 1)]).T
    bernstein = np.array([[math.comb(i, j) / math.comb(n, j) for j in range(n + 1)] for i in range(n + 1)])
    return powers, np.ascontiguousarray(bernstein @ shift @ powers)


# One table for each degree: [d] of the first axis; the degrees in use are 2 and 4.
POWERS, BERNSTEIN = np.zeros((5, 9, 9)), np.zeros((5, 9, 9))
for _d in (2, 4):
    POWERS[_d, : 2 * _d + 1, : 2 * _d + 1], BERNSTEIN[_d, : 2 * _d + 1, : 2 * _d + 1] = _tables(_d)


@njit(**OPTIONS)
def _bracketed(a: Floats, n: int, lo: float, hi: float, f_lo: float) -> float:
    """Zero of the polynomial a[0] + .. + a[n] t^n in [lo, hi], over which its sign changes once; f_lo: value at lo."""
    t = 0.5 * (lo + hi)
    for _ in range(64):
        f, g = a[n], 0.0
        for i in range(n - 1, -1, -1):
            g = g * t + f
            f = f * t + a[i]
        if f == 0.0:
            return t
        if (f > 0) == (f_lo > 0):
            lo = t
        else:
            hi = t
        new = t - f / g
        if abs(new - t) < CONVERGED:
            return new
        t = new if lo < new < hi else 0.5 * (lo + hi)
    return t


@njit(**OPTIONS)
def _extrema(b: Floats, n: int, a: Floats, work: Floats, out: Floats) -> int:
    """Zeros in [-1, 1] of F' in ascending order; b: its n+1 Bernstein coefficients, a: its powers; returns how many.

    `work` (DEPTH+2, >= n+3) is the stack of intervals not yet examined: coefficients and, in the last two
    columns, where it begins and its width.
    """
    count = 0
    top = 0
    last = work.shape[1] - 1
    for i in range(n + 1):
        work[0, i] = b[i]
    work[0, last - 1], work[0, last] = -1.0, 2.0
    while top >= 0:
        row = work[top]
        changes = 0
        for i in range(n):
            changes += (row[i] > 0) != (row[i + 1] > 0)
        lo, width = row[last - 1], row[last]
        if changes == 0:
            top -= 1
        elif changes == 1:
            out[count] = _bracketed(a, n, lo, lo + width, row[0])
            count += 1
            top -= 1
        elif width < 2.0**-DEPTH:
            # A double zero of F', that is a flat inflexion: a break more does no harm.
            out[count] = lo + 0.5 * width
            count += 1
            top -= 1
        else:
            # The right half stays in place, the left half goes on top and is examined first.
            left = work[top + 1]
            for j in range(n + 1):
                left[j] = row[0]
                for i in range(n - j):
                    row[i] = 0.5 * (row[i] + row[i + 1])
            left[last - 1], left[last] = lo, 0.5 * width
            row[last - 1], row[last] = lo + 0.5 * width, 0.5 * width
            top += 1
    return count


@njit(**OPTIONS)
def _horner(a: Floats, n: int, t: float) -> float:
    f = a[n]
    for i in range(n - 1, -1, -1):
        f = f * t + a[i]
    return f


@njit(**OPTIONS)
def _roots_on_half(f: Floats, d: int, nearly_real: float, work: Floats, out: Floats) -> int:
    """Roots t in [-1, 1] of (1 + t^2)^d f(2 atan t) into out; returns how many."""
    n = 2 * d
    a, da, db, breaks = work[0], work[1], work[2], work[3]
    previous = 0.0
    for i in range(n + 1):
        power, value = 0.0, 0.0
        for k in range(n + 1):
            power += POWERS[d, i, k] * f[k]
            value += BERNSTEIN[d, i, k] * f[k]
        a[i] = power
        if i:
            da[i - 1] = i * power
            db[i - 1] = value - previous
        previous = value
    m = _extrema(db, n - 1, da, work[4:], breaks)
    breaks[m] = 1.0
    lo, f_lo, count = -1.0, _horner(a, n, -1.0), 0
    for i in range(m + 1):
        hi = breaks[i]
        f_hi = _horner(a, n, hi)
        if (f_lo > 0) != (f_hi > 0):
            out[count] = _bracketed(a, n, lo, hi, f_lo)
            count += 1
        elif i < m and nearly_real > 0:
            # An extremum on this side of zero: a minimum of |F| if F'' has the sign of F.
            curvature = 0.0
            for k in range(n, 1, -1):
                curvature = curvature * hi + k * (k - 1) * a[k]
            metric = 0.5 * nearly_real * (1 + hi * hi)
            if f_hi * curvature > 0 and 2 * abs(f_hi) < metric * metric * abs(curvature):
                out[count] = hi
                count += 1
        lo, f_lo = hi, f_hi
    return count


@njit(**OPTIONS)
def roots_on_circle(memory: Floats, d: int, nearly_real: float) -> int:
    """The number of angles at which f vanishes; memory[1] gets their cosines, memory[2] their sines, each (12,).

    memory[0]: C_0, C_1, S_1, ..., C_d, S_d of f, d = 2 or 4, overwritten; memory (ROWS, 12) from row 3 on is scratch.
    Zero for a polynomial that is not finite or vanishes identically.
    """
    f, cosines, sines, work = memory[0], memory[1], memory[2], memory[3:]
    # Cut at the diameter whose ends are farthest from zero.
    best, cut, scale = -1.0, 0, 0.0
    for j in range(SAMPLES // 2):
        even, odd = f[0], 0.0
        for k in range(1, d + 1):
            term = f[2 * k - 1] * COS[(j * k) % SAMPLES] + f[2 * k] * SIN[(j * k) % SAMPLES]
            if k % 2:
                odd += term
            else:
                even += term
        least = abs(abs(even) - abs(odd))
        scale = max(scale, abs(even) + abs(odd))
        if least > best:
            best, cut = least, j
    if not 0 < scale < 1e300:
        return 0
    for k in range(1, d + 1):
        m = (k * (cut + SAMPLES // 4)) % SAMPLES
        c, s = f[2 * k - 1] / scale, f[2 * k] / scale
        f[2 * k - 1], f[2 * k] = c * COS[m] + s * SIN[m], s * COS[m] - c * SIN[m]
    f[0] /= scale
    count = 0
    t = work[-1]
    for half in range(2):
        found = _roots_on_half(f, d, nearly_real, work, t)
        m = (cut + SAMPLES // 4 + half * (SAMPLES // 2)) % SAMPLES
        for i in range(found):
            if count < 2 * d:
                norm = 1 / (1 + t[i] * t[i])
                c, s = (1 - t[i] * t[i]) * norm, 2 * t[i] * norm
                cosines[count], sines[count] = c * COS[m] - s * SIN[m], s * COS[m] + c * SIN[m]
                count += 1
        for k in range(1, d + 1, 2):
            f[2 * k - 1], f[2 * k] = -f[2 * k - 1], -f[2 * k]
    return count
