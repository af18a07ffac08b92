"""Depth in OpenEXR files, as Record3D and renderers write it: one channel of floating-point numbers."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from miniloop_cli.errors import InputError
from miniloop_cli.scene.image_source import ImageHeader
from miniloop_cli.typing import Floats32

DEPTH_CHANNEL = re.compile(r"(.*\.)?(z|v|y|depth|distance)", re.IGNORECASE)


def exr_header(file: BinaryIO) -> ImageHeader:
    """Size of the data window. Raises InputError (reason only) if no channel can be depth."""
    with _opened(file.read(), header_only=True) as exr:
        header = exr.header()
        _depth_channels([channel.name for channel in header["channels"]])
        return ImageHeader(*_size(header), 32, 1, "EXR")


def exr_depth(data: bytes) -> Floats32:
    """The (h, w) float32 channel that is depth, of a file whose `exr_header` was found to be of allowed size.

    It is the only one, the one called Z, V, Y or depth (also of a layer, `Layer.Z`), or R where R, G and B are equal.
    Raises InputError (reason only) for other channels, and for missing pixels.
    """
    with _opened(data, separate_channels=True) as exr:
        width, height = _size(exr.header())
        channels = {name: np.asarray(channel.pixels) for name, channel in exr.channels().items()}
    names = _depth_channels(list(channels))
    pixels = channels[names[0]]
    if pixels.shape != (height, width):
        raise InputError("truncated or damaged EXR, it cannot be read")
    if not all(np.array_equal(pixels, channels[name], equal_nan=True) for name in names[1:]):
        raise InputError("an EXR of colours, not of depth")
    return pixels.astype(np.float32)


def _depth_channels(names: list[str]) -> list[str]:
    """The channel that is depth, or several that must be equal."""
    if len(names) == 1:
        return names
    called = [name for name in names if DEPTH_CHANNEL.fullmatch(name)]
    if len(called) == 1:
        return called
    colour = [name for name in names if name in ("R", "G", "B")]
    if len(colour) == 3 and not called:
        return colour
    raise InputError(f"an EXR of the channels {', '.join(names)[:100]}: it is not clear which is depth")


def _size(header: dict[str, Any]) -> tuple[int, int]:
    (left, top), (right, bottom) = header["dataWindow"]
    return int(right) - int(left) + 1, int(bottom) - int(top) + 1


@contextmanager
def _opened(data: bytes, **how: bool) -> Iterator[Any]:
    """The data as a temporary file, as the library's reader of streams crashes on damaged data."""
    import OpenEXR

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "depth.exr"
        path.write_bytes(data)
        with OpenEXR.File(str(path), **how) as exr:
            yield exr
