"""Record3D's depth and confidence: plain arrays compressed by Apple's LZFSE (wheel pyliblzfse).

The library does not limit the unpacked size, so the blocks of the data are checked first. A block of LZFSE states its
number of matches, each of at most MAX_MATCH bytes (github.com/lzfse/lzfse, src/lzfse_internal.h).
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets.damage import damage
from miniloop_cli.datasets.optional_wheel import optional_wheel
from miniloop_cli.datasets.paths import read_bytes
from miniloop_cli.errors import InputError
from miniloop_cli.runtime.artifact_store import content_fingerprint
from miniloop_cli.scene.image_source import ImageHeader

MAX_MATCH = 2359  # bytes of one match
MAX_UNPACKED_BYTES = 512 << 20
MAX_PACKED_BYTES = 16 << 20
LZVN_RATIO = 140  # of its longest match to the length of the opcode


@dataclass(frozen=True)
class LzfseImage:
    """The image source of a compressed array of (height, width) `dtype` values ("<f4" metres or "|u1" levels)."""

    path: Path
    width: int
    height: int
    dtype: str

    @property
    def name(self) -> str:
        return os.fspath(self.path)

    def header(self) -> ImageHeader:
        return ImageHeader(self.width, self.height, 8 * np.dtype(self.dtype).itemsize, 1, "LZFSE")

    def read(self) -> NDArray[Any]:
        kind = np.dtype(self.dtype)
        count = self.width * self.height * kind.itemsize
        data = unpack(read_bytes(self.path, MAX_PACKED_BYTES), count)
        return np.frombuffer(data, kind).reshape(self.height, self.width).astype(kind.newbyteorder("="))

    def fingerprint(self) -> str:
        try:
            return content_fingerprint([np.frombuffer(read_bytes(self.path, MAX_PACKED_BYTES), np.uint8)])
        except InputError:
            return "unreadable"


def unpack(data: bytes, count: int) -> bytes:
    """The `count` bytes in LZFSE data. Raises InputError (reason only) for damaged data and for another size."""
    stated, bound = sizes(data)
    if stated != count:
        raise InputError(f"{stated} bytes of pixels instead of {count}")
    if bound > MAX_UNPACKED_BYTES:
        raise InputError("its compressed data claim far more than the image; they are not unpacked")
    library = optional_wheel("liblzfse", "pyliblzfse", "phones")
    with damage("the LZFSE data are damaged and cannot be decompressed"):
        found = library.decompress(data)
    if len(found) != count:
        raise InputError("the LZFSE data are damaged: their size is not the stated one")
    return bytes(found)


def sizes(data: bytes) -> tuple[int, int]:
    """The size in bytes stated by the blocks of LZFSE data, and a bound of their real size. Raises InputError."""
    stated = bound = offset = 0
    try:
        while (magic := data[offset : offset + 4]) != b"bvx$":
            size = struct.unpack_from("<I", data, offset + 4)[0]
            stated += size
            if magic == b"bvx2":
                literals, states, header = struct.unpack_from("<3Q", data, offset + 8)
                bound += (literals & 0xFFFFF) + MAX_MATCH * (literals >> 40 & 0xFFFFF)
                step = (header & 0xFFFFFFFF) + (literals >> 20 & 0xFFFFF) + (states >> 40 & 0xFFFFF)
            elif magic == b"bvxn":
                payload = struct.unpack_from("<I", data, offset + 8)[0]
                bound, step = bound + min(size, LZVN_RATIO * payload), 12 + payload
            elif magic == b"bvx-":
                bound, step = bound + size, 8 + size
            else:
                raise InputError("no LZFSE data" if not offset else "damaged LZFSE data")
            offset += max(step, 8)
    except struct.error:
        raise InputError("the LZFSE data are cut off") from None
    return stated, bound
