"""TIFF, PPM, NPY and EXR, read without Pillow, which lacks 16-bit colour in them or changes their values."""

from __future__ import annotations

import io
import re
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets.exr import exr_depth, exr_header
from miniloop_cli.errors import InputError
from miniloop_cli.scene.image_source import ImageHeader

MAX_TAGS = 200
WIDTH, HEIGHT, BITS, CHANNELS = 256, 257, 258, 277
PNM = re.compile(rb"P([56])(?:\s|#[^\n]*\n)+(\d+)(?:\s|#[^\n]*\n)+(\d+)(?:\s|#[^\n]*\n)+(\d+)\s")
PNM_HEADER_BYTES = 2048


@dataclass(frozen=True)
class RawFormat:
    """The first bytes of a format, and the readers of its header and its pixels, which may raise any exception."""

    name: str
    starts: tuple[bytes, ...]
    header: Callable[[BinaryIO], ImageHeader]
    decode: Callable[[bytes], NDArray[Any]]


def raw_format(start: bytes) -> RawFormat | None:
    """The format of an image that begins with these bytes, if it is one of these."""
    return next((kind for kind in RAW_FORMATS if start.startswith(kind.starts)), None)


def _tiff_header(file: BinaryIO) -> ImageHeader:
    """From the tags of the first image in the file."""
    start = file.read(8)
    order = "<" if start[:2] == b"II" else ">"
    file.seek(struct.unpack(order + "I", start[4:8])[0])
    count = struct.unpack(order + "H", file.read(2))[0]
    tags = {CHANNELS: 1, BITS: 1}
    for _ in range(min(count, MAX_TAGS)):
        tag, kind, values = struct.unpack(order + "HHI", file.read(8))
        field = file.read(4)
        if tag in (WIDTH, HEIGHT, CHANNELS) or (tag == BITS and values == 1):
            tags[tag] = struct.unpack(order + ("H" if kind == 3 else "I"), field[: 2 if kind == 3 else 4])[0]
        elif tag == BITS:
            tags[tag] = -1 if values > 2 else struct.unpack(order + "H", field[:2])[0]
            where = struct.unpack(order + "I", field)[0]
    if tags[BITS] == -1:
        file.seek(where)
        tags[BITS] = struct.unpack(order + "H", file.read(2))[0]
    return ImageHeader(tags[WIDTH], tags[HEIGHT], tags[BITS], tags[CHANNELS], "TIFF")


def _tiff_pixels(data: bytes) -> NDArray[Any]:
    import cv2

    stored = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if stored is None:
        raise InputError("damaged TIFF, it cannot be decoded")
    if stored.ndim == 2:
        return _plain(np.asarray(stored))
    return np.ascontiguousarray(stored[..., 2::-1])


def _pnm_header(file: BinaryIO) -> ImageHeader:
    kind, width, height, largest, _ = _pnm_start(file.read(PNM_HEADER_BYTES))
    return ImageHeader(width, height, 16 if largest > 255 else 8, 3 if kind == 6 else 1, "PPM" if kind == 6 else "PGM")


def _pnm_start(data: bytes) -> tuple[int, int, int, int, int]:
    match = PNM.match(data)
    if match is None:
        raise InputError("damaged PPM or PGM")
    kind, width, height, largest = (int(group) for group in match.groups())
    return kind, width, height, largest, match.end()


def _pnm_pixels(data: bytes) -> NDArray[Any]:
    """Values as stored; 8-bit ones are stretched if their largest is not 255."""
    kind, width, height, largest, start = _pnm_start(data[:PNM_HEADER_BYTES])
    channels, dtype = (3 if kind == 6 else 1), np.dtype(">u2" if largest > 255 else np.uint8)
    count = width * height * channels
    if len(data) - start < count * dtype.itemsize:
        raise InputError("truncated PPM or PGM")
    values = np.frombuffer(data, dtype, count, start).reshape((height, width, channels)[: 2 + (channels > 1)])
    if largest not in (255, 65535) and (largest < 255 or kind == 6):
        top = 255 if largest < 255 else 65535
        return np.round(values.astype(float) * top / largest).astype(np.uint8 if top == 255 else np.uint16)
    return values.astype(np.uint16 if largest > 255 else np.uint8)


def _npy_header(file: BinaryIO) -> ImageHeader:
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    return _array_header(shape, dtype, "NPY")


def _npz_header(file: BinaryIO) -> ImageHeader:
    with zipfile.ZipFile(file) as archive, archive.open(_member(archive)) as inner:
        return _npy_header(io.BytesIO(inner.read(1024)))


def _array_header(shape: tuple[int, ...], dtype: np.dtype[Any], kind: str) -> ImageHeader:
    if len(shape) not in (2, 3) or dtype.kind not in "fiu":
        raise InputError(f"an array of shape {shape} and type {dtype} is not an image")
    channels = shape[2] if len(shape) == 3 else 1
    bits = 8 * dtype.itemsize if dtype.itemsize <= 2 and dtype.kind != "f" else 32  # as it is read
    return ImageHeader(shape[1], shape[0], bits, channels, kind)


def _npy_pixels(data: bytes) -> NDArray[Any]:
    stored = np.load(io.BytesIO(data), allow_pickle=False)
    _array_header(stored.shape, stored.dtype, "NPY")
    stored = stored[..., 0] if stored.ndim == 3 and stored.shape[2] == 1 else stored
    return _plain(stored)


def _plain(stored: NDArray[Any]) -> NDArray[Any]:
    """Whole numbers of 8 or 16 bits as unsigned ones (negative: 0, no reading), all others as 32-bit float."""
    if stored.dtype.itemsize > 2 or stored.dtype.kind == "f":
        return stored.astype(np.float32)
    return np.maximum(stored, 0).astype(np.uint8 if stored.dtype.itemsize == 1 else np.uint16)


def _npz_pixels(data: bytes) -> NDArray[Any]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return _npy_pixels(archive.read(_member(archive)))


def _member(archive: zipfile.ZipFile) -> str:
    """The one array of an NPZ file, or that called depth."""
    names = archive.namelist()
    name = "depth.npy" if "depth.npy" in names else names[0]
    if len(names) != 1 and name != "depth.npy":
        raise InputError(f"an NPZ file of {len(names)} arrays, none called depth")
    if archive.getinfo(name).file_size > 256 << 20:
        raise InputError("an NPZ file of more than 256 MB")
    return name


RAW_FORMATS = (
    RawFormat("TIFF", (b"II*\0", b"MM\0*"), _tiff_header, _tiff_pixels),
    RawFormat("PPM or PGM", (b"P5", b"P6"), _pnm_header, _pnm_pixels),
    RawFormat("NPY", (b"\x93NUMPY",), _npy_header, _npy_pixels),
    RawFormat("NPZ", (b"PK\x03\x04",), _npz_header, _npz_pixels),
    RawFormat("EXR", (b"v/1\x01",), exr_header, exr_depth),
)
