"""One stored image of a recording, wherever it lies: in a file, an archive, a video, a bag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray


@dataclass(frozen=True)
class ImageHeader:
    """What a stored image says it is: its size in pixels, bits a channel, channels, and its format's name."""

    width: int
    height: int
    bits: int
    channels: int
    kind: str

    def __str__(self) -> str:
        return f"{self.bits}-bit {self.channels}-channel {self.kind} of {self.width} x {self.height}"


class ImageSource(Protocol):
    """Where an image lies and how it is read.

    A source is a small frozen value: it holds neither pixels nor an open file, so that a recording of any length fits
    in memory and its frames go to other threads and processes (it must be picklable, and compare by value). A
    container that is slow to open is kept open by the reader's own module, once a process.
    """

    @property
    def name(self) -> str:
        """The path of the file; within a container, its path and then the name inside. For messages."""

    def header(self) -> ImageHeader:
        """Size and type, without decoding. Raises InputError (reason only)."""

    def read(self) -> NDArray[Any]:
        """The pixels as stored: (h, w, 3) RGB or (h, w), uint8 or uint16. Raises InputError (reason only)."""

    def fingerprint(self) -> str:
        """Hash of the content, of its absence where it cannot be read: what is kept of the image goes by this."""
