"""Readout and lag of a camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # a run that finds refined poses in the store needs no bundle adjustment
    pass


@dataclass(frozen=True)
class Timing:
    """readout_s: from the first row of a colour image to the last; lag_s: depth was taken so much after its stamp."""

    readout_s: float = 0.0
    lag_s: float = 0.0
