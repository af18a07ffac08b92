"""The terms of a refinement: residuals of a point seen from a pose, and residuals of poses alone.

A term is one class in one file. It gives residuals in units of their standard deviations, their derivatives, and their
robust kernel. The adjustments take lists of terms, and minimise the sum of rho(|r|^2) / 2 over all rows of all terms.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Protocol, Self

from miniloop_cli.refinement.robust import Robust
from miniloop_cli.typing import Floats, Ints

NEAR_M = 0.02  # a point nearer than this (or behind) has no useful projection
BEHIND = 1e2  # its residual: a constant, without derivative


class PointTerm(Protocol):
    """Residuals of the points of tracks in the frames that see them, one row of `d` residuals an observation.

    The last axis of arrays runs over the k observations, so that numpy works on contiguous values.
    """

    @property
    def robust(self) -> Robust:
        """The kernel on the norm of a row's residuals."""
        ...

    def of(self, rows: Ints | slice) -> Self:
        """The term of the observations of rows (m,), in this order, or of a range of them."""
        ...

    def linearise(self, p_cam: Floats) -> tuple[Floats, Floats]:
        """Residuals (d, k), NaN where nothing was measured, and derivatives (d, 3, k) by the points.

        p_cam (3, k) m, in the camera's frame. Of points nearer than NEAR_M the derivatives do not count.
        """
        ...


class Gauge(IntEnum):
    """Motions of the whole that change no residual of a term."""

    NOTHING = 0  # poses are measured in the world
    HEADING = 1  # the vertical is z: position and a turn about z are free
    POSE = 2  # poses are measured relative to each other: all six are free


class PoseTerm(Protocol):
    """Residuals of poses: m rows of `d` residuals, each of which depends on `p` poses."""

    @property
    def robust(self) -> Robust:
        """The kernel on the norm of a row's residuals."""
        ...

    @property
    def frames(self) -> Ints:
        """(m, p) the poses of each row; no pose twice in a row."""
        ...

    @property
    def gauge(self) -> Gauge:
        """The motions of the world that these residuals do not measure."""
        ...

    def linearise(self, T_world_cam: Floats) -> tuple[Floats, Floats]:
        """Residuals (m, d) and their derivatives (m, p, d, 6) at the poses (n, 4, 4).

        By steps (w, v) of the poses: rotation (rad), then translation (m), T_world_cam [exp(w) | v].
        """
        ...
