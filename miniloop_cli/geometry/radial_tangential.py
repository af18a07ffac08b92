"""The lens of Brown and Conrady as OpenCV defines it, with 5 coefficients or, rational, 8: k1 k2 p1 p2 k3 k4 k5 k6.

Points x, y lie on the plane z = 1, s = x^2 + y^2, and g = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3):
x_d = x g + 2 p1 x y + p2 (s + 2 x^2), y_d = y g + p1 (s + 2 y^2) + 2 p2 x y.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.polynomial import Polynomial

from miniloop_cli.geometry.monotone import first_root, invert_increasing
from miniloop_cli.typing import Floats

Coefficients = tuple[float, ...]
ARRIVED_PX = 1e-6


def polynomials(c: Coefficients) -> tuple[Polynomial, Polynomial]:
    """Numerator and denominator of g, in s."""
    k1, k2, _, _, k3, k4, k5, k6 = (*c, 0.0, 0.0, 0.0)[:8]
    return Polynomial([1.0, k1, k2, k3]), Polynomial([1.0, k4, k5, k6])


def distort(xy: Floats, c: Coefficients) -> Floats:
    """(n, 2) ideal points to the (n, 2) points that the lens images; NaN beyond its `limit`."""
    x, y = xy.T
    p1, p2 = c[2:4]
    s = x * x + y * y
    with np.errstate(all="ignore"):
        g = _share(s, c)
        bent_x = x * g + 2 * p1 * x * y + p2 * (s + 2 * x * x)
        bent = np.stack([bent_x, y * g + p1 * (s + 2 * y * y) + 2 * p2 * x * y], 1)
    bent[~(s <= limit(c)[0] ** 2)] = np.nan
    return bent


def jacobian(xy: Floats, c: Coefficients) -> Floats:
    """(n, 2, 2) derivative of `distort` at (n, 2) ideal points; it is symmetric."""
    x, y = xy.T
    p1, p2 = c[2:4]
    with np.errstate(all="ignore"):
        g, g_s = _growth(x * x + y * y, c)
        xx = g + 2 * x * x * g_s + 2 * p1 * y + 6 * p2 * x
        across = 2 * x * y * g_s + 2 * p1 * x + 2 * p2 * y
        yy = g + 2 * y * y * g_s + 6 * p1 * y + 2 * p2 * x
    return np.stack([np.stack([xx, across], 1), np.stack([across, yy], 1)], 1)


def _share(s: Floats, c: Coefficients) -> Floats:
    """g at (n,) s."""
    k1, k2, _, _, k3, k4, k5, k6 = (*c, 0.0, 0.0, 0.0)[:8]
    return np.asarray((1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6))), float)


def _growth(s: Floats, c: Coefficients) -> tuple[Floats, Floats]:
    """g and its derivative at (n,) s."""
    numerator, denominator = polynomials(c)
    g = _share(s, c)
    return g, (numerator.deriv()(s) - g * denominator.deriv()(s)) / denominator(s)


@cache
def limit(c: Coefficients) -> tuple[float, float]:
    """Radius of ideal points up to which the measured radius grows with them, and the measured radius there.

    Both may be infinite. Beyond, the polynomial folds over: two directions would share a pixel. Tangential
    coefficients are ignored.
    """
    a, b = polynomials(c)
    fold, pole = first_root(_slope(c)), first_root(b)
    if pole <= fold:
        return float(np.sqrt(pole)), np.inf
    return float(np.sqrt(fold)), float(np.sqrt(fold) * a(fold) / b(fold))


def _slope(c: Coefficients) -> Polynomial:
    """Growth of the measured radius r g with the ideal radius r, times the denominator squared, in s = r^2."""
    (a, b), s = polynomials(c), Polynomial([0.0, 1.0])
    return (a + 2 * s * a.deriv()) * b - 2 * s * a * b.deriv()


def undistort(px: Floats, K: Floats, c: Coefficients) -> Floats:
    """(n, 2) measured pixels to the (n, 2) pixels that an ideal camera of the same K (3, 3) would measure.

    OpenCV's fixed-point iteration; Newton's method for pixels of strong lenses where it does not converge.
    """
    import cv2

    # OpenCV's default of five steps leaves 0.1 px at the corners of a strong lens.
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
    ideal = np.asarray(cv2.undistortImagePoints(px, K, np.array(c), arg1=until), float).reshape(-1, 2)
    f, centre = np.array([K[0, 0], K[1, 1]]), K[:2, 2]
    error_px = np.abs(distort((ideal - centre) / f, c) * f + centre - px).max(axis=1)
    astray = ~(error_px <= ARRIVED_PX)  # NaN compares false
    if astray.any():
        ideal[astray] = _newton((px[astray] - centre) / f, c) * f + centre
    return ideal


def _newton(xy_measured: Floats, c: Coefficients) -> Floats:
    """Ideal points (n, 2) of measured ones: along the radius first, where the solution is unique, then in the plane."""
    a, b = polynomials(c)
    slope, end = _slope(c), limit(c)[0]
    radius = np.linalg.norm(xy_measured, axis=1)

    def value(r: Floats) -> Floats:
        with np.errstate(all="ignore"):
            return np.nan_to_num(r * a(r * r) / b(r * r), nan=np.inf)

    ideal_radius = invert_increasing(value, lambda r: slope(r * r) / b(r * r) ** 2, radius, end * (1 - 1e-12))
    start = xy = xy_measured * (ideal_radius / np.where(radius > 0, radius, 1.0))[:, None]
    for _ in range(20):
        residual, J = distort(xy, c) - xy_measured, jacobian(xy, c)
        steady = np.isfinite(residual).all(axis=1) & (np.abs(np.linalg.det(J)) > 1e-12)
        J = np.where(steady[:, None, None], J, np.eye(2))
        xy = xy - np.linalg.solve(J, np.where(steady[:, None], residual, 0.0)[:, :, None])[:, :, 0]
    arrived = np.abs(distort(xy, c) - xy_measured).max(axis=1) < 1e-9
    return np.where(arrived[:, None], xy, start)
