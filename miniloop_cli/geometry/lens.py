"""What a lens does to pixels: none (pinhole), radial-tangential or fisheye, each with its inverse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.geometry import fisheye, radial_tangential
from miniloop_cli.typing import Floats

COEFFICIENTS = {
    "pinhole": (),
    "radial-tangential": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
_FORMULAS = {"radial-tangential": radial_tangential, "fisheye": fisheye}


@dataclass(frozen=True)
class Lens:
    """A lens model and its coefficients, in the order of COEFFICIENTS; radial-tangential has 5 of them or 8."""

    model: str = "pinhole"
    coefficients: tuple[float, ...] = ()

    @property
    def ideal(self) -> bool:
        """Whether measured pixels are those of the pinhole camera already."""
        return self.model == "pinhole"

    @property
    def named(self) -> dict[str, float]:
        """The coefficients by their names."""
        return dict(zip(COEFFICIENTS[self.model], self.coefficients, strict=False))

    def __str__(self) -> str:
        """Model and coefficients, for people."""
        values = ", ".join(f"{name} {value:g}" for name, value in self.named.items() if value)
        return f"{self.model} ({values})" if values else self.model

    def undistort(self, px: Floats, K: Floats) -> Floats:
        """(n, 2) measured pixels to the (n, 2) pixels that an ideal pinhole camera of the same K (3, 3) would measure.

        Pixels that the lens cannot reach (see `limit`) take the farthest that it does.
        """
        if self.ideal or not len(px):
            return px
        return _FORMULAS[self.model].undistort(px, K, self.coefficients)

    def distort(self, px_ideal: Floats, K: Floats) -> Floats:
        """The inverse: (n, 2) ideal pixels to (n, 2) measured ones, K (3, 3); NaN for those the lens cannot image."""
        if self.ideal or not len(px_ideal):
            return px_ideal
        f, centre = np.array([K[0, 0], K[1, 1]]), K[:2, 2]
        return _FORMULAS[self.model].distort((px_ideal - centre) / f, self.coefficients) * f + centre

    @property
    def limit(self) -> tuple[float, float]:
        """Ideal radius up to which the measured radius grows, and the measured radius there, on the plane z = 1.

        Infinite for most lenses. A fisheye's first number is the angle off the axis (rad), at most pi / 2.
        """
        return (np.inf, np.inf) if self.ideal else _FORMULAS[self.model].limit(self.coefficients)


PINHOLE = Lens()


def radial_tangential_lens(*coefficients: float) -> Lens:
    """The lens of up to 8 coefficients k1 k2 p1 p2 k3 k4 k5 k6, missing ones 0; a pinhole if all are."""
    c = tuple(float(value) for value in coefficients) + (0.0,) * (8 - len(coefficients))
    if not any(c):
        return PINHOLE
    return Lens("radial-tangential", c if any(c[5:]) else c[:5])


def fisheye_lens(k1: float = 0.0, k2: float = 0.0, k3: float = 0.0, k4: float = 0.0) -> Lens:
    """The lens of Kannala and Brandt; with all coefficients 0 it is still not a pinhole."""
    return Lens("fisheye", (float(k1), float(k2), float(k3), float(k4)))
