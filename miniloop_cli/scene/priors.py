"""What is known of the frames beside their images."""

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
        """In axes that R (3, 3) maps those of now into."""
        return replace(self, readings=self.readings @ R.T, up=self.up @ R.T)


@dataclass(frozen=True)
class Vertical:
    """Readings in the axes of the cameras (x right, y down, z forward), and how far their mean directions are off.

    sigma_deg: at the median, from the edges that the images alone are sure of. R_cam_sensor (3, 3): from the sensor's
    own axes into the camera's.
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
    """Of n frames: what an accelerometer read, and rough poses `T_world_cam` (n, 4, 4); None where not given.

    Rows of frames of which nothing is known are NaN. `notes`: what was converted when they were read.
    """

    accelerometer: Accelerometer | None = None
    T_world_cam: Floats | None = None
    notes: tuple[Note, ...] = ()
