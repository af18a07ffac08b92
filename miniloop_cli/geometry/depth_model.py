"""The smooth errors of a depth camera: an offset, a bend over the range, and the change of both towards the corners.

Depths of structured-light sensors are wrong by a smooth function of range and position in the image (Teichman, Miller
& Thrun, RSS 2013; Herrera, Kannala & Heikkila, PAMI 2012). The model has no common factor: a recording does not
determine the unit of length, which only the depth camera fixes. All terms vanish at the middle of the range or in the
mean over the image, so that none of them acts as such a factor.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache

import numpy as np

from miniloop_cli.typing import Floats, Floats32

MEAN_RHO = 1 / 3  # over an image


@dataclass(frozen=True)
class DepthModel:
    """How a reading z (m) at a pixel is corrected, with rho the squared share of the way from the centre to a corner:

    z + offset_m (1 - z / middle_m) + bend_per_m z (z - middle_m)
      + (rho - 1/3) z (radial + radial_bend_per_m (z - middle_m)).
    """

    offset_m: float = 0.0
    bend_per_m: float = 0.0
    radial: float = 0.0
    radial_bend_per_m: float = 0.0
    middle_m: float = 1.0

    @property
    def exact(self) -> bool:
        """Whether readings stay as they are."""
        return not any(self.coefficients)

    @property
    def coefficients(self) -> tuple[float, ...]:
        """All but the middle of the range."""
        return self.offset_m, self.bend_per_m, self.radial, self.radial_bend_per_m

    @property
    def increasing(self) -> bool:
        """Whether farther readings stay farther, from 0.1 to 10 m and in every part of the image."""
        z_m, edge = (each.ravel() for each in np.meshgrid(np.linspace(0.1, 10, 50), np.linspace(0, 1, 5)))
        slope = basis(z_m, edge, self.middle_m)[1]
        return bool((1 + np.tensordot(np.array(self.coefficients), slope, 1) > 0.1).all())

    def corrected(self, z_m: Floats, rho: Floats) -> Floats:
        """Corrected readings (...) m; `rho` (...): see `rho`."""
        # The sum over `basis`, sorted by factors, as this runs over whole images.
        edge, off = rho - MEAN_RHO, z_m - self.middle_m
        factor = 1 - self.offset_m / self.middle_m + self.radial * edge
        factor += (self.bend_per_m + self.radial_bend_per_m * edge) * off
        return self.offset_m + z_m * factor

    def of_image(self, depth_m: Floats32) -> Floats32:
        """The corrected depth image (h, w), m, 0 = no reading. A reading that becomes negative is set to 0."""
        z_m = depth_m.astype(float)
        found = np.where(z_m > 0, np.maximum(self.corrected(z_m, _rho_of_image(*depth_m.shape)), 0.0), 0.0)
        return found.astype(np.float32)


NAMES = tuple(field.name for field in fields(DepthModel))[:-1]
EXACT = DepthModel()


def rho(px: Floats, width: int, height: int) -> Floats:
    """Squared distance (k,) of pixels (k, 2) from the centre of the image, 1 in its corners."""
    half = np.array([(width - 1) / 2, (height - 1) / 2])
    return ((px - half) ** 2).sum(axis=1) / (half @ half)


@cache
def _rho_of_image(height: int, width: int) -> Floats:
    """`rho` (h, w) of all pixels."""
    v, u = np.mgrid[0:height, 0:width]
    return rho(np.stack([u.ravel(), v.ravel()], axis=1).astype(float), width, height).reshape(height, width)


def basis(z_m: Floats, rho: Floats, middle_m: float) -> tuple[Floats, Floats]:
    """What a unit of each coefficient adds to readings (k,) m, and its derivative by the reading: both (4, k)."""
    off, edge, one = z_m - middle_m, rho - MEAN_RHO, np.ones_like(z_m)
    value = np.stack([-off / middle_m, z_m * off, edge * z_m, edge * z_m * off])
    slope = np.stack([-one / middle_m, z_m + off, edge, edge * (z_m + off)])
    return value, slope
