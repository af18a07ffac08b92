"""The depth of a colour image without a depth image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from miniloop_cli.scene.image_source import ImageHeader, ImageSource
from miniloop_cli.typing import UInt16s


@dataclass(frozen=True)
class NoDepth:
    """An image source without any reading, of the size of the colour image."""

    color: ImageSource

    @property
    def name(self) -> str:
        return self.color.name

    def header(self) -> ImageHeader:
        return replace(self.color.header(), bits=16, channels=1)

    def read(self) -> UInt16s:
        header = self.color.header()
        return np.zeros((header.height, header.width), np.uint16)

    def fingerprint(self) -> str:
        return "no depth"
