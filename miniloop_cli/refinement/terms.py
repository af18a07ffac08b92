"""What a refinement is made of: residuals of a point seen from a pose, and residuals of poses alone.

A term is one class in one file: its residuals in units of their standard deviations, their derivatives, and the robust
kernel that they are under. The adjustments take lists of terms and know nothing of what these measure. They minimise
the sum of rho(|r|^2) / 2 over all rows of all terms.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Protocol, Self

from miniloop_cli.refinement.robust import Robust
from miniloop_cli.typing import Floats, Ints

NEAR_M = 0.02  # a point nearer than this (or behind) has no useful projection
BEHIND = 1e2  # its residual: constant, so it neither pulls nor pays


class PointTerm(Protocol):
    """Residuals of the points of tracks in the frames that see them, one row of `d` residuals an observation.

    Arrays are columns: a residual's values for all k observations lie side by side, so that numpy runs along them.
    """

    @property
    def robust(self) -> Robust:
        """The kernel on the norm of a row's residuals."""
        ...

    def of(self, rows: Ints) -> Self:
        """The term of the observations of rows (m,), in this order."""
        ...

    def linearise(self, p_cam: Floats) -> tuple[Floats, Floats]:
        """Residuals (d, k), NaN where nothing was measured, and derivatives (d, 3, k) by the points.

        p_cam (3, k) m, in the camera's frame. Of points nearer than NEAR_M the derivatives do not count.
        """
        ...


class Gauge(IntEnum):
    """What moves as a whole without any residual of a term noticing."""

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
        """What of the world these residuals leave open."""
        ...

    def linearise(self, T_world_cam: Floats) -> tuple[Floats, Floats]:
        """Residuals (m, d) and their derivatives (m, p, d, 6) at the poses (n, 4, 4).

        By steps (w, v) of the poses: rotation (rad), then translation (m), T_world_cam [exp(w) | v].
        """
        ...
