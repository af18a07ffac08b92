"""Compact points that a browser unpacks without a library: differences, in planes of bytes, deflated.

Neighbours in Morton order differ little, so their differences (modulo 2^16 and 2^8) compress well. Red and blue are
stored as differences to green, which are mostly small (Malvar and Sullivan 2003).
"""

from __future__ import annotations

import base64
import zlib

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.typing import Bytes

LEVEL = 1  # of zlib: a little larger than level 6, but much faster


def pack_points(steps: NDArray[np.uint16], colors: Bytes) -> bytes:
    """(n, 3) steps and (n, 3) RGB, deflated (zlib): of the differences to the point before, low and high bytes of
    x, y, z, then r - g, g, b - g."""
    jumps = np.diff(steps, axis=0, prepend=np.zeros((1, 3), np.uint16))  # wraps around
    shades = np.diff(colors, axis=0, prepend=np.zeros((1, 3), np.uint8))
    planes = [part for axis in range(3) for part in (jumps[:, axis] & 255, jumps[:, axis] >> 8)]
    green = shades[:, 1]
    planes += [shades[:, 0] - green, green, shades[:, 2] - green]
    return zlib.compress(b"".join(plane.astype(np.uint8).tobytes() for plane in planes), LEVEL)


def unpack_points(packed: bytes) -> tuple[NDArray[np.uint16], Bytes]:
    """Steps (n, 3) and colours (n, 3) from the bytes of `pack_points`."""
    planes = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(9, -1)
    jumps = planes[0:6:2].astype(np.uint16) | (planes[1:6:2].astype(np.uint16) << 8)
    shades = planes[6:].T + np.array([[1, 0, 1]], np.uint8) * planes[7][:, None]
    return np.cumsum(jumps.T, axis=0, dtype=np.uint16), np.cumsum(shades, axis=0, dtype=np.uint8)


def coarser(steps: NDArray[np.uint16], spacing: float) -> NDArray[np.uint16]:
    """(n, 3) steps rounded to a power of two, at most an eighth of `spacing` steps: invisible, and it packs well.

    `spacing`: distance of most neighbouring points, in steps.
    """
    bits = max(int(np.log2(max(spacing / 8, 1))), 0)
    half = np.uint32((1 << bits) >> 1)
    top = np.uint32((65535 >> bits) << bits)
    return np.minimum((steps + half) >> bits << bits, top).astype(np.uint16)


def text(data: bytes) -> str:
    """Bytes as base64."""
    return base64.b64encode(data).decode("ascii")
