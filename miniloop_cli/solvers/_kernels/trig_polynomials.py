"""Complex trigonometric polynomials of degree 1 in an angle a: coefficients of e^{-ia}, 1, e^{ia}, as tuples.

The elimination of the 5-cycle is ordinary algebra with them; a product of two has degree 2.
"""

from __future__ import annotations

from miniloop_cli.runtime.kernels import njit
from miniloop_cli.solvers._kernels.alignment import OPTIONS, Point
from miniloop_cli.typing import Floats

Waves = tuple[complex, complex, complex]
Waves2 = tuple[complex, complex, complex, complex, complex]


@njit(**OPTIONS)
def waves(x: Point, y: Point) -> Waves:
    """x + iy, coefficients of (1, cos a, sin a), as coefficients of e^{-ia}, 1, e^{ia}."""
    return (
        complex(0.5 * (x[1] - y[2]), 0.5 * (y[1] + x[2])),
        complex(x[0], y[0]),
        complex(0.5 * (x[1] + y[2]), 0.5 * (y[1] - x[2])),
    )


@njit(**OPTIONS)
def mix(s: complex, x: Waves, t: complex, y: Waves) -> Waves:
    """s x + t y."""
    return s * x[0] + t * y[0], s * x[1] + t * y[1], s * x[2] + t * y[2]


@njit(**OPTIONS)
def conj(x: Waves) -> Waves:
    """The complex conjugate, at real angles."""
    return x[2].conjugate(), x[1].conjugate(), x[0].conjugate()


@njit(**OPTIONS)
def product(x: Waves, y: Waves) -> Waves2:
    """Coefficients of e^{-2ia} .. e^{2ia}."""
    return (
        x[0] * y[0],
        x[0] * y[1] + x[1] * y[0],
        x[0] * y[2] + x[1] * y[1] + x[2] * y[0],
        x[1] * y[2] + x[2] * y[1],
        x[2] * y[2],
    )


@njit(**OPTIONS)
def value(x: Waves, e: complex) -> complex:
    """x at the angle e = e^{ia}."""
    return x[0] * e.conjugate() + x[1] + x[2] * e


@njit(**OPTIONS)
def norm_excess(N: Waves2, W: Waves, f: Floats) -> None:
    """|N|^2 - W^2 as coefficients of 1, cos a, sin a, .., cos 4a, sin 4a into f (9,); W real, from e^0 on."""
    n0, n1, n2, n3, n4 = N
    c0, c1, c2, c3 = n0.conjugate(), n1.conjugate(), n2.conjugate(), n3.conjugate()
    w0, w1, w2 = W
    f[0] = (n0 * c0 + n1 * c1 + n2 * c2 + n3 * c3 + n4 * n4.conjugate()).real
    f[0] -= (w0 * w0 + 2 * (w1 * w1.conjugate() + w2 * w2.conjugate())).real
    f1 = n1 * c0 + n2 * c1 + n3 * c2 + n4 * c3 - 2 * (w0 * w1 + w1.conjugate() * w2)
    f2 = n2 * c0 + n3 * c1 + n4 * c2 - 2 * w0 * w2 - w1 * w1
    f3 = n3 * c0 + n4 * c1 - 2 * w1 * w2
    f4 = n4 * c0 - w2 * w2
    f[1], f[2], f[3], f[4] = 2 * f1.real, -2 * f1.imag, 2 * f2.real, -2 * f2.imag
    f[5], f[6], f[7], f[8] = 2 * f3.real, -2 * f3.imag, 2 * f4.real, -2 * f4.imag
