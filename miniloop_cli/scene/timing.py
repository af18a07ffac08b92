"""Readout and lag of a camera."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """readout_s: from the first row of a colour image to the last; lag_s: from the stamp of depth to its exposure."""

    readout_s: float = 0.0
    lag_s: float = 0.0
