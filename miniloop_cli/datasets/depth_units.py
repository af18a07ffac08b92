"""Depth images with their own units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.scene.image_source import ImageHeader, ImageSource


@dataclass(frozen=True)
class MetricDepth:
    """A depth image with `units_per_m` units a metre, as float32 metres."""

    depth: ImageSource
    units_per_m: float

    @property
    def name(self) -> str:
        return self.depth.name

    def header(self) -> ImageHeader:
        return replace(self.depth.header(), bits=32)

    def read(self) -> NDArray[Any]:
        return self.depth.read().astype(np.float32) / np.float32(self.units_per_m)

    def fingerprint(self) -> str:
        return f"{self.depth.fingerprint()}/{self.units_per_m!r}"
