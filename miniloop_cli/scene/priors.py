"""What is known of the frames beside their images."""

from __future__ import annotations

from dataclasses import dataclass

from miniloop_cli.typing import Floats


@dataclass(frozen=True)
class Priors:
    """Of n frames: `up_sensor` (n, 3) unit vectors in the axes of the sensor, `T_world_cam` (n, 4, 4) rough poses.

    Rows of frames of which nothing is known are NaN; None where nothing was given.
    """

    up_sensor: Floats | None = None
    T_world_cam: Floats | None = None
