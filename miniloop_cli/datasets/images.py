"""Image files, looked at before they are decoded: what they are, how large, and whether they are whole."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets.paths import read_bytes
from miniloop_cli.errors import InputError, out_of_memory
from miniloop_cli.typing import Bools, Bytes

MAX_PIXELS = 40_000_000
MAX_IMAGE_BYTES = 256 << 20
PNG_MAGIC, JPEG_MAGIC = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
_CHANNELS = {0: "1-channel", 2: "3-channel", 3: "palette", 4: "2-channel", 6: "4-channel"}


@dataclass(frozen=True)
class Header:
    """What an image file says it is; `bits` and `color_type` as PNG defines them."""

    width: int
    height: int
    bits: int
    color_type: int
    kind: str

    def __str__(self) -> str:
        return f"{self.bits}-bit {_CHANNELS[self.color_type]} {self.kind} of {self.width} x {self.height}"


def png_header(data: bytes) -> Header:
    """The IHDR of a PNG file's first 26 bytes or more; ValueError says what is wrong."""
    if len(data) < 26 or data[12:16] != b"IHDR":
        raise ValueError("truncated or damaged PNG")
    width, height, bits, color_type = struct.unpack(">IIBB", data[16:26])
    if color_type not in _CHANNELS:
        raise ValueError("damaged PNG header")
    return Header(width, height, bits, color_type, "PNG")


def jpeg_header(data: bytes) -> tuple[Header, int]:
    """Frame header of a JPEG file and where its compressed scan begins; ValueError says what is wrong."""
    position, header = 2, None
    while position + 9 < len(data):
        if data[position] != 0xFF:
            break
        marker, length = data[position + 1], struct.unpack_from(">H", data, position + 2)[0]
        if marker == 0xFF:  # fill byte
            position += 1
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            bits, height, width, channels = struct.unpack_from(">BHHB", data, position + 4)
            header = Header(width, height, bits, 0 if channels == 1 else 2, "JPEG")
        if marker == 0xDA and header:
            return header, position
        position += 2 + max(length, 2)
    raise ValueError("truncated or damaged JPEG")


def read_header(path: Path) -> Header:
    """Kind and size of an image file from its first bytes, undecoded. Raises InputError (reason only) otherwise."""
    data = read_bytes(path, MAX_IMAGE_BYTES, first=64)
    if data.startswith(JPEG_MAGIC):  # cameras put previews and profiles before the size
        data = read_bytes(path, MAX_IMAGE_BYTES, first=1 << 20)
    try:
        return _checked_header(data)
    except ValueError as error:
        raise InputError(str(error)) from None


def _checked_header(data: bytes) -> Header:
    if data.startswith(PNG_MAGIC):
        header = png_header(data)
    elif data.startswith(JPEG_MAGIC):
        header = jpeg_header(data)[0]
    else:
        raise ValueError("empty file" if not data else "neither PNG nor JPEG")
    if not header.width or not header.height:
        raise ValueError("an image without pixels")
    if header.width * header.height > MAX_PIXELS:
        limit = f"{MAX_PIXELS // 10**6} megapixels"
        raise ValueError(f"{header.width} x {header.height} pixels are more than the {limit} allowed")
    return header


def _check_whole(data: bytes) -> None:
    """A decoder fills the missing rest of a broken file with anything; so look first, checksums included."""
    if data.startswith(JPEG_MAGIC):
        if data.rfind(b"\xff\xd9") < jpeg_header(data)[1]:
            raise ValueError("truncated JPEG")
        return
    view, position = memoryview(data), len(PNG_MAGIC)
    while position + 12 <= len(data):
        length = struct.unpack_from(">I", data, position)[0]
        end = position + 12 + length
        if end > len(data):
            break
        if zlib.crc32(view[position + 4 : end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            raise ValueError("damaged PNG (checksum)")
        if data[position + 4 : position + 8] == b"IEND":
            return
        position = end
    raise ValueError("truncated PNG")


def _decode(data: bytes, flags: int) -> NDArray:
    import cv2

    _check_whole(data)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        if out_of_memory(error):
            raise
        image = None
    if image is None:
        raise ValueError("damaged image, it cannot be decoded")
    return image


def read_color(path: Path) -> Bytes:
    """(h, w, 3) uint8 RGB of a PNG or JPEG file, as stored: an EXIF orientation is left alone, as depth has none.

    Raises InputError (reason only, the caller knows the frame) for a file that is missing, broken or too large.
    """
    import cv2

    data = read_bytes(path, MAX_IMAGE_BYTES)
    try:
        _checked_header(data)
        return cv2.cvtColor(_decode(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION), cv2.COLOR_BGR2RGB)
    except ValueError as error:
        raise InputError(str(error)) from None


def read_depth(path: Path) -> NDArray[np.uint16]:
    """(h, w) uint16 of a 16-bit one-channel PNG file.

    Raises InputError (reason only, the caller knows the frame) for anything else.
    """
    import cv2

    data = read_bytes(path, MAX_IMAGE_BYTES)
    try:
        header = _checked_header(data)
        if (header.kind, header.bits, header.color_type) != ("PNG", 16, 0):
            raise ValueError(f"depth must be a 16-bit 1-channel PNG, this is a {header}")
        depth = _decode(data, cv2.IMREAD_UNCHANGED)
    except ValueError as error:
        raise InputError(str(error)) from None
    if depth.dtype != np.uint16 or depth.shape != (header.height, header.width):
        raise InputError("depth did not decode to one 16-bit channel")
    return depth


def read_mask(path: Path) -> Bools:
    """(h, w) bool of a mask image: True = ignore, where any channel is not 0. Raises InputError."""
    return read_color(path).any(axis=2)
