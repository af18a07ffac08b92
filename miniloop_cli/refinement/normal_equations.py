"""From residuals to normal equations: point terms by the points in the cameras, pose terms by the poses."""

from __future__ import annotations

from typing import NamedTuple

from miniloop_cli.typing import Floats


class PointEquations(NamedTuple):
    """Of k observations: points p_cam (3, k) m, gradient (k, 3) and Hessian (k, 6) of the cost by them.

    A row of the Hessian holds the entries 00 01 02 11 12 22.
    """

    p_cam: Floats
    gradient: Floats
    hessian: Floats
