"""ScanNet's .sens files: a header, then frame by frame the pose, two stamps, and the encoded colour and depth.

All numbers are little-endian (github.com/ScanNet/ScanNet, SensReader/python/SensorData.py). Opening reads only the
sizes of the frames, not the images.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from miniloop_cli.datasets.block_source import FileBlock
from miniloop_cli.datasets.images import MAX_IMAGE_BYTES, MAX_PIXELS
from miniloop_cli.datasets.paths import open_file, shown
from miniloop_cli.errors import InputError
from miniloop_cli.typing import Floats

VERSION = 4
MAX_SENS_BYTES = 256 << 30
MAX_NAME_BYTES = 4096
MAX_FRAMES = 2_000_000
HEADER = struct.Struct("<64f2i4IfQ")
FRAME = struct.Struct("<16f4Q")
COLOR = {0: "raw", 1: "PNG", 2: "JPEG"}
DEPTH = {0: "raw", 1: "zlib", 2: "occi"}


@dataclass(frozen=True)
class SensHeader:
    """Cameras and encodings: (4, 4) intrinsics and extrinsics, (width, height) in pixels, depth units a metre."""

    K_color: Floats
    K_depth: Floats
    extrinsics: tuple[Floats, Floats]
    codecs: tuple[str, str]
    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    depth_scale: float
    frames: int  # as stated by the header


@dataclass(frozen=True)
class SensFile:
    """The content of a .sens file: (n, 4, 4) float poses camera to world, (n, 2) stamps (us), and the images."""

    header: SensHeader
    poses: Floats
    stamps_us: Floats
    color: tuple[FileBlock, ...]
    depth: tuple[FileBlock, ...]


def read_sens(path: Path) -> SensFile:
    """The header and the positions of all images; a truncated file gives its whole frames.

    Raises InputError naming the file if it is of another kind or version, or has no whole frame.
    """
    with open_file(path, MAX_SENS_BYTES) as file:
        end = file.seek(0, os.SEEK_END)
        file.seek(0)
        header = _read_header(file, shown(path))
        poses, stamps, color, depth = [], [], [], []
        for number in range(min(header.frames, MAX_FRAMES)):
            start = file.read(FRAME.size)
            if len(start) < FRAME.size:
                break
            *values, color_us, depth_us, color_bytes, depth_bytes = FRAME.unpack(start)
            offset = file.tell()
            sizes = (color_bytes, depth_bytes)
            if not min(sizes) or max(sizes) > MAX_IMAGE_BYTES or offset + sum(sizes) > end:
                break
            poses.append(np.array(values).reshape(4, 4))
            stamps.append((color_us, depth_us))
            raw = "rgb" if header.codecs[0] == "raw" else ""
            color.append(FileBlock(path, f"color/{number:06d}", offset, color_bytes, raw, *header.color_size))
            offset += color_bytes
            zipped = header.codecs[1] == "zlib"
            depth.append(FileBlock(path, f"depth/{number:06d}", offset, depth_bytes, "u2", *header.depth_size, zipped))
            file.seek(depth_bytes + offset)
    if not color:
        raise InputError(f"{shown(path)} holds no whole frame of the {header.frames} that it claims: it is cut off")
    return SensFile(header, np.array(poses), np.array(stamps, float), tuple(color), tuple(depth))


def _read_header(file: BinaryIO, where: str) -> SensHeader:
    start = file.read(12)
    if len(start) < 12:
        raise InputError(f"{where} is cut off within its header")
    version, length = struct.unpack("<IQ", start)
    if version != VERSION or length > MAX_NAME_BYTES:
        raise InputError(f"{where} is not a .sens file of version {VERSION}")
    file.seek(length, os.SEEK_CUR)
    rest = file.read(HEADER.size)
    if len(rest) < HEADER.size:
        raise InputError(f"{where} is cut off within its header")
    values = HEADER.unpack(rest)
    matrices = np.array(values[:64]).reshape(4, 4, 4)
    color, depth, *sizes = values[64:70]
    codecs = COLOR.get(color, ""), DEPTH.get(depth, "")
    if not all(codecs):
        raise InputError(f"{where}: colour of kind {color} and depth of kind {depth} are not supported")
    if codecs[1] == "occi":
        raise InputError(f"{where}: depth in occi compression is not supported; write it again with zlib (kind 1)")
    scale, count = values[70], values[71]
    if not np.isfinite(scale) or not 1 <= scale < 1e6:
        raise InputError(f"{where}: impossible depth shift: {scale:g} units a metre")
    if not all(1 <= size <= 1 << 14 for size in sizes) or max(sizes[0] * sizes[1], sizes[2] * sizes[3]) > MAX_PIXELS:
        raise InputError(f"{where}: images of {sizes[0]} x {sizes[1]} and {sizes[2]} x {sizes[3]} pixels")
    K_color, T_color, K_depth, T_depth = matrices
    shapes = (sizes[0], sizes[1]), (sizes[2], sizes[3])
    return SensHeader(K_color, K_depth, (T_color, T_depth), (codecs[0], codecs[1]), *shapes, scale, count)
