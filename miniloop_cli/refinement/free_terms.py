"""Point terms that also depend on parameters of the camera."""

from __future__ import annotations

from typing import Protocol, Self

from miniloop_cli.geometry.camera_parameters import CameraParameters
from miniloop_cli.refinement.terms import PointTerm
from miniloop_cli.typing import Floats


class FreeTerm(PointTerm, Protocol):
    """A point term whose residuals also depend on the parameters of the camera (geometry/camera_parameters.py)."""

    def at(self, parameters: CameraParameters) -> Self:
        """The term with other parameters."""
        ...

    def by_parameters(self, p_cam: Floats) -> Floats:
        """Derivatives (d, len(NAMES), k) of the residuals by the parameters, at points p_cam (3, k) m."""
        ...
