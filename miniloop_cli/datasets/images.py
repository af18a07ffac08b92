"""Encoded images; format, size and completeness are checked before decoding."""

from __future__ import annotations

import io
import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import ImageOps
from PIL.BmpImagePlugin import BmpImageFile
from PIL.ImageFile import ImageFile as Decoder
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.WebPImagePlugin import WebPImageFile

from miniloop_cli.datasets.archive_path import ArchivePath
from miniloop_cli.datasets.damage import damage
from miniloop_cli.datasets.paths import open_file, read_bytes
from miniloop_cli.datasets.raw_images import raw_format
from miniloop_cli.errors import InputError, out_of_memory
from miniloop_cli.runtime.artifact_store import file_fingerprint
from miniloop_cli.scene.image_source import ImageHeader

MAX_PIXELS = 40_000_000
MAX_IMAGE_BYTES = 256 << 20
# The first and last bytes of each format, as decoders do not notice missing last bytes. WebP states its length.
FORMATS: dict[bytes, tuple[type[Decoder], bytes]] = {
    b"\x89PNG\r\n\x1a\n": (PngImageFile, b"IEND\xaeB`\x82"),
    b"\xff\xd8\xff": (JpegImageFile, b"\xff\xd9"),
    b"RIFF": (WebPImageFile, b""),
    b"BM": (BmpImageFile, b""),
}
UNREADABLE = "truncated or damaged {}, it cannot be read"
KNOWN = "PNG, JPEG, WebP, TIFF, BMP, PPM or PGM, NPY or EXR"
START = 16  # bytes that identify a format
ORIENTATION = 0x0112  # EXIF: 1 as stored; 5 to 8 turned by 90 degrees


@dataclass(frozen=True)
class ImageFile:
    """The image source of an ordinary image file; `upright`: rotated by its EXIF orientation."""

    path: Path
    upright: bool = False

    @property
    def name(self) -> str:
        return os.fspath(self.path)

    @property
    def on_disk(self) -> bool:
        """Whether it is an ordinary file, which other programs can open, not one within an archive."""
        return not isinstance(self.path, ArchivePath)

    def header(self) -> ImageHeader:
        with open_file(self.path, MAX_IMAGE_BYTES) as file:
            header = read_header(file)
            if self.upright and read_orientation(file) >= 5:
                return replace(header, width=header.height, height=header.width)
            return header

    def read(self) -> NDArray[Any]:
        return decode(read_bytes(self.path, MAX_IMAGE_BYTES), self.upright)

    def fingerprint(self) -> str:
        return file_fingerprint(self.path) + ("u" if self.upright else "")


def read_header(file: BinaryIO) -> ImageHeader:
    """Kind and size of an encoded image, undecoded. Raises InputError (reason only) if it has none, or too large."""
    start = file.read(START)
    file.seek(0)
    if raw := raw_format(start):
        with damage(UNREADABLE.format(raw.name)):
            return _of_allowed_size(raw.header(file))
    return _header(_open(file)[0])


def read_orientation(file: BinaryIO) -> int:
    """The EXIF orientation of an encoded image: 1 (as stored) to 8; 1 where there is none."""
    file.seek(0)
    try:
        found = _open(file)[0].getexif().get(ORIENTATION, 1)
    except Exception as error:
        if out_of_memory(error):
            raise
        return 1
    return found if isinstance(found, int) and 1 <= found <= 8 else 1


def decode(data: bytes, upright: bool = False) -> NDArray[Any]:
    """The pixels of an image file as stored: RGB, or (h, w) of one channel, of uint8, uint16 or float32; read only.

    The EXIF orientation is applied only if `upright`, as depth has none. Raises InputError (reason only) for data
    that are damaged, truncated or too large; the size is checked before anything is decoded.
    """
    if raw := raw_format(data[:START]):
        with damage(UNREADABLE.format(raw.name)):
            _of_allowed_size(raw.header(io.BytesIO(data)))
            return raw.decode(data)
    image, end = _open(io.BytesIO(data))
    _header(image)
    if end not in data or (data.startswith(b"RIFF") and len(data) < 8 + int.from_bytes(data[4:8], "little")):
        raise InputError(f"truncated {image.format}")
    with damage(f"damaged {image.format}, it cannot be decoded"):
        _open(io.BytesIO(data))[0].verify()  # checksums, which decoding does not check
        image.info.pop("transparency", None)  # transparent pixels have a colour; Pillow would warn
        plain = image if image.mode in ("I;16", "L", "RGB") else image.convert("RGB")
        return np.asarray(ImageOps.exif_transpose(plain) if upright else plain)


def _open(file: BinaryIO) -> tuple[Decoder, bytes]:
    start = file.read(START)
    file.seek(0)
    kind, end = next((FORMATS[magic] for magic in FORMATS if start.startswith(magic)), (None, b""))
    if kind is None:
        raise InputError("empty file" if not start else f"not {KNOWN}")
    with damage(f"a truncated or damaged {kind.format}, or one without pixels"):
        return kind(file), end


def _of_allowed_size(header: ImageHeader) -> ImageHeader:
    if header.width * header.height > MAX_PIXELS:
        limit = f"{MAX_PIXELS // 10**6} megapixels"
        raise InputError(f"{header.width} x {header.height} pixels are more than the {limit} allowed")
    if header.width < 1 or header.height < 1:
        raise InputError(f"a {header.kind} without pixels")
    return header


def _header(image: Decoder) -> ImageHeader:
    width, height = image.size
    # The raw mode of a decoder gives the stored width of a channel: "RGB", "L;4", "I;16B".
    raw = str(image.tile[0].args) if image.tile else ""
    bits = 1 if image.mode == "1" else int(found[1]) if (found := re.search(r";(\d+)", raw)) else 8
    return _of_allowed_size(ImageHeader(width, height, bits, len(image.getbands()), image.format or "image"))
