"""The fisheye lens of Kannala and Brandt (PAMI 2006) as OpenCV's cv2.fisheye defines it, with k1 k2 k3 k4.

A direction at angle theta off the axis is imaged at radius theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 +
k4 theta^8) on the plane z = 1; the ideal pinhole images it at tan(theta).
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial

from miniloop_cli.geometry.monotone import first_root, invert_increasing
from miniloop_cli.typing import Floats

Coefficients = tuple[float, ...]


def polynomial(c: Coefficients) -> Polynomial:
    """Measured radius as a polynomial of theta (rad)."""
    return Polynomial([0.0, 1.0, 0.0, c[0], 0.0, c[1], 0.0, c[2], 0.0, c[3]])


def distort(xy: Floats, c: Coefficients) -> Floats:
    """(n, 2) ideal points to the (n, 2) points that the lens images; NaN beyond its `limit`."""
    radius = np.linalg.norm(xy, axis=1)
    theta = np.arctan(radius)
    measured = polynomial(c)(theta)
    scale = np.divide(measured, radius, out=np.ones_like(radius), where=radius > 0)
    scale[~(theta <= limit(c)[0])] = np.nan
    return xy * scale[:, None]


def limit(c: Coefficients) -> tuple[float, float]:
    """Angle theta (rad, at most pi / 2) up to which the measured radius grows with it, and the radius there.

    Beyond pi / 2 no pinhole image shows a direction; before it, the polynomial may fold over.
    """
    radius = polynomial(c)
    theta = min(first_root(radius.deriv()), np.pi / 2)
    return theta, float(radius(theta))


def undistort(px: Floats, K: Floats, c: Coefficients) -> Floats:
    """(n, 2) measured pixels to the (n, 2) pixels that an ideal camera of the same K (3, 3) would measure."""
    f, centre = np.array([K[0, 0], K[1, 1]]), K[:2, 2]
    xy = (px - centre) / f
    measured = np.linalg.norm(xy, axis=1)
    radius = polynomial(c)
    theta = invert_increasing(radius, radius.deriv(), measured, limit(c)[0] * (1 - 1e-9))
    scale = np.divide(np.tan(theta), measured, out=np.ones_like(measured), where=measured > 0)
    return xy * scale[:, None] * f + centre
