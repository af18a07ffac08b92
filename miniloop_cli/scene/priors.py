"""Prior knowledge of frames: accelerometer readings and rough poses."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from miniloop_cli.scene.sequence import Note
from miniloop_cli.typing import Floats


@dataclass(frozen=True)
class Accelerometer:
    """Readings (r, 3), upwards at rest, in any unit and in the sensor's own axes, at stamps_s (r,), ascending.

    `up` (n, 3): the mean direction around each of n frames, unit vectors, NaN where there are no readings.
    `source` names the file.
    """

    stamps_s: Floats
    readings: Floats
    up: Floats
    source: str = "the accelerometer's file"

    def turned(self, R: Floats) -> Accelerometer:
        """The readings with their axes mapped by R (3, 3)."""
        return replace(self, readings=self.readings @ R.T, up=self.up @ R.T)


@dataclass(frozen=True)
class Vertical:
    """Readings in the axes of the cameras (x right, y down, z forward), and the error of their mean directions.

    sigma_deg: the median, against sure edges. R_cam_sensor (3, 3): from the sensor's axes to the camera's.
    """

    accelerometer: Accelerometer
    sigma_deg: float
    R_cam_sensor: Floats = field(default_factory=lambda: np.eye(3))

    @property
    def up_cam(self) -> Floats:
        """(n, 3) unit vectors, NaN where there is none."""
        return self.accelerometer.up


@dataclass(frozen=True)
class Priors:
    """Priors of n frames: accelerometer readings, and rough poses `T_world_cam` (n, 4, 4); None if not given.

    Rows of frames without a prior are NaN. `notes`: conversions while reading.
    """

    accelerometer: Accelerometer | None = None
    T_world_cam: Floats | None = None
    notes: tuple[Note, ...] = ()
