"""The image source of some bytes of a large file, such as a video of JPEGs or a log of frames."""

from __future__ import annotations

import hashlib
import os
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets.images import MAX_IMAGE_BYTES, MAX_PIXELS, decode, read_header
from miniloop_cli.errors import InputError
from miniloop_cli.scene.image_source import ImageHeader


class Layout(NamedTuple):
    """How raw pixels are stored: type, channels, rows, conversion to RGB."""

    dtype: str
    channels: int
    rows_per_height: float = 1.0
    convert: str = ""


LAYOUTS = {
    "b16g": Layout(">u2", 1),
    "u2": Layout("<u2", 1),
    "rgb": Layout("u1", 3),
    "nv12": Layout("u1", 1, 1.5, "COLOR_YUV2RGB_NV12"),
    "yuy2": Layout("u1", 2, 1.0, "COLOR_YUV2RGB_YUY2"),
}


@dataclass(frozen=True)
class FileBlock:
    """`size` bytes at `offset` of a file: an image file (`layout` empty), or raw pixels; `zipped`: by zlib."""

    path: Path
    part: str  # what the block is called in messages
    offset: int
    size: int
    layout: str = ""
    width: int = 0
    height: int = 0
    zipped: bool = False

    @property
    def name(self) -> str:
        return f"{os.fspath(self.path)}/{self.part}"

    def header(self) -> ImageHeader:
        if self.layout:
            kind = LAYOUTS[self.layout]
            if not 0 < self.width * self.height <= MAX_PIXELS:
                raise InputError(f"{self.width} x {self.height} pixels are not allowed")
            channels = 3 if kind.convert else kind.channels
            return ImageHeader(self.width, self.height, 8 * np.dtype(kind.dtype).itemsize, channels, "raw image")
        import io

        return read_header(io.BytesIO(self._bytes()))

    def read(self) -> NDArray[Any]:
        if not self.layout:
            return decode(self._bytes())
        import cv2

        self.header()
        kind, data = LAYOUTS[self.layout], self._bytes()
        dtype, rows = np.dtype(kind.dtype), round(self.height * kind.rows_per_height)
        needed = rows * self.width * kind.channels * dtype.itemsize
        if self.zipped:
            data = _unzipped(data, needed)
        if len(data) != needed:
            raise InputError(f"{len(data)} bytes, expected {needed} of a {self.header()}")
        if kind.convert and (self.width % 2 or self.height % 2):
            raise InputError(f"{self.width} x {self.height} is not a possible size of such an image")
        pixels = np.frombuffer(data, dtype).reshape(rows, self.width, kind.channels)
        if kind.convert:
            return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), getattr(cv2, kind.convert)))
        pixels = pixels.astype(dtype.newbyteorder("="))
        return pixels[..., 0] if kind.channels == 1 else pixels

    def fingerprint(self) -> str:
        try:
            return hashlib.sha256(self._bytes()).hexdigest() + self.layout
        except InputError:
            return "unreadable"

    def _bytes(self) -> bytes:
        if not 0 < self.size <= MAX_IMAGE_BYTES:
            raise InputError("empty" if self.size <= 0 else f"an image of {self.size / 2**20:.0f} MB")
        try:
            with self.path.open("rb") as file:
                file.seek(self.offset)
                data = file.read(self.size)
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}") from error
        if len(data) != self.size:
            raise InputError("the file ends within this image")
        return data


def _unzipped(data: bytes, size: int) -> bytes:
    try:
        return zlib.decompressobj().decompress(data, size + 1)
    except zlib.error as error:
        raise InputError("it is damaged and cannot be decompressed") from error
