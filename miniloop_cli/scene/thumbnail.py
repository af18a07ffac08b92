"""The view of a scan: a small image with depth."""

from __future__ import annotations

from dataclasses import dataclass

from miniloop_cli.typing import Floats32


@dataclass(frozen=True)
class View:
    """A scan as a small image of undistorted cells, all (rows, COLUMNS) float32, 0 where there is no reading.

    `gray`: mean brightness; `z_m`: depth of cells on one surface; `low_m`, `high_m`: nearest and farthest depth of a
    cell and its eight neighbours.
    """

    gray: Floats32
    z_m: Floats32
    low_m: Floats32
    high_m: Floats32
