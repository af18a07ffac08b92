"""One stored image of a recording: in a file, an archive, a video, a bag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray


@dataclass(frozen=True)
class ImageHeader:
    """The properties stated by a stored image: size in pixels, bits a channel, channels, name of the format."""

    width: int
    height: int
    bits: int
    channels: int
    kind: str

    def __str__(self) -> str:
        return f"{self.bits}-bit {self.channels}-channel {self.kind} of {self.width} x {self.height}"


class ImageSource(Protocol):
    """The position of an image, and its reader.

    A source is a small frozen value without pixels or open files, so that a recording of any length fits in memory and
    its frames can be sent to other threads and processes (it must be picklable, and compare by value). A container that
    is slow to open is kept open by the reader's module, once a process.
    """

    @property
    def name(self) -> str:
        """The path of the file, in a container followed by the name inside; for messages."""

    def header(self) -> ImageHeader:
        """Size and type, without decoding. Raises InputError (reason only)."""

    def read(self) -> NDArray[Any]:
        """The pixels as stored: (h, w, 3) RGB or (h, w), uint8 or uint16. Raises InputError (reason only)."""

    def fingerprint(self) -> str:
        """Hash of the content, or of its absence if it cannot be read; part of cache keys."""
