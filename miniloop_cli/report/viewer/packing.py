"""Points as few bytes that a browser unpacks without a library: differences, in planes of bytes, deflated.

Neighbours in Morton order differ little, so their differences (modulo 2^16 and 2^8) deflate to less than half.
"""

from __future__ import annotations

import base64
import zlib

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.typing import Bytes


def pack_points(steps: NDArray[np.uint16], colors: Bytes) -> bytes:
    """(n, 3) steps and (n, 3) RGB, deflated (zlib): low and high bytes of x, y, z, then r, g, b, of the differences."""
    jumps = np.diff(steps, axis=0, prepend=np.zeros((1, 3), np.uint16))  # wraps around
    shades = np.diff(colors, axis=0, prepend=np.zeros((1, 3), np.uint8))
    planes = [part for axis in range(3) for part in (jumps[:, axis] & 255, jumps[:, axis] >> 8)]
    planes += [shades[:, channel] for channel in range(3)]
    return zlib.compress(b"".join(plane.astype(np.uint8).tobytes() for plane in planes), 6)


def unpack_points(packed: bytes) -> tuple[NDArray[np.uint16], Bytes]:
    """Steps (n, 3) and colours (n, 3) from the bytes of `pack_points`."""
    planes = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(9, -1)
    jumps = planes[0:6:2].astype(np.uint16) | (planes[1:6:2].astype(np.uint16) << 8)
    return np.cumsum(jumps.T, axis=0, dtype=np.uint16), np.cumsum(planes[6:].T, axis=0, dtype=np.uint8)


def text(data: bytes) -> str:
    """Bytes as base64."""
    return base64.b64encode(data).decode("ascii")
