"""Points of the scene from the bundle adjustment, and their observations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.typing import Bools, Floats, Floats32


@dataclass(frozen=True)
class Landmarks:
    """`points_world` (p, 3) metres; k observations, by point, then by frame: `point` (k,), `frame` (k,), `px` (k, 2).

    Pixels are those of the features, without lens distortion, pixel centres at integers. No frame sees a point twice.
    """

    points_world: Floats
    point: NDArray[np.int32]
    frame: NDArray[np.int32]
    px: Floats32

    def seen_at(self, rows: Bools, min_frames: int = 2) -> Landmarks:
        """These observations (k,) of the points that still have `min_frames`; points are renumbered."""
        count = np.bincount(self.point[rows], minlength=len(self.points_world))
        kept = count >= min_frames
        rows = rows & kept[self.point]
        number = np.cumsum(kept, dtype=np.int32) - np.int32(1)
        return Landmarks(self.points_world[kept], number[self.point[rows]], self.frame[rows], self.px[rows])


NO_LANDMARKS = Landmarks(np.zeros((0, 3)), np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, 2), np.float32))
