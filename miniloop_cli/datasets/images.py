"""Encoded images, looked at before they are decoded: what they are, how large, and whether they are whole."""

from __future__ import annotations

import io
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL.ImageFile import ImageFile as Decoder
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from miniloop_cli.datasets.paths import open_file, read_bytes
from miniloop_cli.errors import InputError, out_of_memory
from miniloop_cli.runtime.artifact_store import file_fingerprint
from miniloop_cli.scene.image_source import ImageHeader

MAX_PIXELS = 40_000_000
MAX_IMAGE_BYTES = 256 << 20
# How each format begins and how it ends: decoders overlook that the last bytes are missing.
FORMATS: dict[bytes, tuple[type[Decoder], bytes]] = {
    b"\x89PNG\r\n\x1a\n": (PngImageFile, b"IEND\xaeB`\x82"),
    b"\xff\xd8\xff": (JpegImageFile, b"\xff\xd9"),
}


@dataclass(frozen=True)
class ImageFile:
    """The image source of an ordinary PNG or JPEG file."""

    path: Path

    @property
    def name(self) -> str:
        return os.fspath(self.path)

    def header(self) -> ImageHeader:
        with open_file(self.path, MAX_IMAGE_BYTES) as file:
            return read_header(file)

    def read(self) -> NDArray[Any]:
        return decode(read_bytes(self.path, MAX_IMAGE_BYTES))

    def fingerprint(self) -> str:
        return file_fingerprint(self.path)


def read_header(file: BinaryIO) -> ImageHeader:
    """Kind and size of an encoded image, undecoded. Raises InputError (reason only) where it has none, or too large."""
    return _header(_open(file)[0])


def decode(data: bytes) -> NDArray[Any]:
    """The pixels of a PNG or JPEG file: (h, w) uint16 of one channel of 16 bits, (h, w) uint8 of grey, else RGB.

    An EXIF orientation is left alone, as depth has none. Raises InputError (reason only) for data that are damaged,
    truncated or too large; the size is checked before anything is decoded.
    """
    image, end = _open(io.BytesIO(data))
    _header(image)
    if end not in data:
        raise InputError(f"truncated {image.format}")
    try:
        _open(io.BytesIO(data))[0].verify()  # checksums, which decoding leaves out
        if image.mode in ("I;16", "L"):
            return np.array(image)
        image.info.pop("transparency", None)  # what is transparent has a colour too; Pillow would warn about it
        return np.array(image.convert("RGB"))
    except Exception as error:  # what a decoder makes of damaged data is not ours to foresee
        if out_of_memory(error):
            raise
        raise InputError(f"damaged {image.format}, it cannot be decoded") from error


def _open(file: BinaryIO) -> tuple[Decoder, bytes]:
    start = file.read(max(map(len, FORMATS)))
    file.seek(0)
    kind, end = next((FORMATS[magic] for magic in FORMATS if start.startswith(magic)), (None, b""))
    if kind is None:
        raise InputError("empty file" if not start else "neither PNG nor JPEG")
    try:
        return kind(file), end
    except Exception as error:
        if out_of_memory(error):
            raise
        raise InputError(f"a truncated or damaged {kind.format}, or one without pixels") from error


def _header(image: Decoder) -> ImageHeader:
    width, height = image.size
    if width * height > MAX_PIXELS:
        limit = f"{MAX_PIXELS // 10**6} megapixels"
        raise InputError(f"{width} x {height} pixels are more than the {limit} allowed")
    # The raw mode of a decoder tells how wide a channel is stored: "RGB", "L;4", "I;16B".
    raw = str(image.tile[0].args) if image.tile else ""
    bits = 1 if image.mode == "1" else int(found[1]) if (found := re.search(r";(\d+)", raw)) else 8
    return ImageHeader(width, height, bits, len(image.getbands()), image.format or "image")
