"""Features of one scan, those with depth first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.typing import Bools, Floats


@dataclass(frozen=True)
class ScanFeatures:
    """Features of one scan: those with depth first, each part strongest first.

    px: (n, 2) measured pixels; px_ideal: (n, 2) undistorted; z_m: (n,) depth or NaN; slope: (n, 2) change of depth
    along the image (m/px), 0 where it is not smooth; outline: (n,) bool, depth jumps within the feature;
    descriptors: (n, d).
    """

    px: Floats
    px_ideal: Floats
    z_m: Floats
    slope: Floats
    outline: Bools
    descriptors: NDArray[Any]

    @property
    def with_depth(self) -> int:
        """Number of features with a depth, which are the first rows."""
        return int(np.isfinite(self.z_m).sum())

    def __len__(self) -> int:
        return len(self.px)


_NO_PLACES, _NO_NUMBERS = np.zeros((0, 2)), np.zeros(0)
NO_FEATURES = ScanFeatures(
    _NO_PLACES, _NO_PLACES, _NO_NUMBERS, _NO_PLACES, np.zeros(0, bool), np.zeros((0, 128), np.uint8)
)
