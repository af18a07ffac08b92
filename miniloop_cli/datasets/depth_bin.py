"""The depth.bin of ScanNet++'s iPhone recordings, in both forms.

They are those of github.com/scannetpp/scannetpp, iphone/prepare_iphone_data.py. Either each frame by itself: its size
(uint32, little-endian), then an LZ4 block of uint16 millimetres or a raw deflate stream of float32 metres. Or one raw
deflate stream of float32 metres of all frames, which can only be read from its start: it is read frame by frame, and
the state of the decoder is kept every STEP frames.
"""

from __future__ import annotations

import os
import struct
import threading
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets.optional_wheel import optional_wheel
from miniloop_cli.datasets.paths import open_file, shown
from miniloop_cli.errors import InputError
from miniloop_cli.runtime.artifact_store import content_fingerprint, file_fingerprint
from miniloop_cli.runtime.kept_open import KeptOpen
from miniloop_cli.scene.image_source import ImageHeader
from miniloop_cli.typing import Floats32

WIDTH, HEIGHT = 256, 192
PIXELS = WIDTH * HEIGHT
FLOAT_BYTES, SHORT_BYTES = 4 * PIXELS, 2 * PIXELS
MAX_FILE_BYTES = 64 << 30
MAX_BLOCK_BYTES = FLOAT_BYTES + (64 << 10)  # incompressible data grow a little
MAX_FRAMES = 2_000_000
MAX_WHOLE_FRAMES = 100_000
STEP = 64  # frames between kept states of the decoder
READ_BYTES = 256 << 10
MM = np.float32(1000)


@dataclass(frozen=True)
class _DepthFrame:
    """A frame of float32 metres."""

    path: Path
    number: int

    @property
    def name(self) -> str:
        return f"{os.fspath(self.path)}/{self.number:06d}"

    def header(self) -> ImageHeader:
        return _HEADER


@dataclass(frozen=True)
class DepthBlock(_DepthFrame):
    """The image source of a frame that is compressed by itself."""

    offset: int
    size: int

    def read(self) -> NDArray[Any]:
        return decode_block(_block(self.path, self.offset, self.size))

    def fingerprint(self) -> str:
        try:
            return content_fingerprint([np.frombuffer(_block(self.path, self.offset, self.size), np.uint8)])
        except InputError:
            return "unreadable"


@dataclass(frozen=True)
class DepthOfStream(_DepthFrame):
    """The image source of a frame of a file that is compressed as a whole."""

    def read(self) -> NDArray[Any]:
        try:
            return _STREAMS.get(self.path).frame(self.number)
        except OSError as error:
            raise InputError(f"cannot read {shown(self.path)}: {error.strerror or error}") from error

    def fingerprint(self) -> str:
        try:
            return f"{_FINGERPRINTS.get(self.path)}:{self.number}"
        except OSError:
            return "unreadable"


_HEADER = ImageHeader(WIDTH, HEIGHT, 32, 1, "depth.bin")


def depth_frames(path: Path, count: int) -> tuple[DepthBlock, ...] | tuple[DepthOfStream, ...]:
    """The frames of a depth.bin; `count`: the expected number in a file that is one stream.

    Raises InputError naming the file if it has neither form.
    """
    blocks = _blocks(path)
    if blocks:
        return blocks
    try:
        _inflate(zlib.decompressobj(-zlib.MAX_WBITS), _block(path, 0, MAX_BLOCK_BYTES, whole=False), FLOAT_BYTES)
    except InputError as error:
        raise InputError(f"{shown(path)} is not a depth.bin of ScanNet++: {error}") from None
    return tuple(DepthOfStream(path, k) for k in range(min(count, MAX_WHOLE_FRAMES)))


def decode_block(data: bytes) -> Floats32:
    """(192, 256) float32 metres of one compressed frame. Raises InputError (reason only)."""
    lz4 = optional_wheel("lz4.block", "lz4", "phones")
    try:
        short = lz4.decompress(data, uncompressed_size=SHORT_BYTES)
        if len(short) == SHORT_BYTES:
            return np.frombuffer(short, "<u2").reshape(HEIGHT, WIDTH).astype(np.float32) / MM
    except (lz4.LZ4BlockError, ValueError):
        pass  # not LZ4
    return _metres(_inflate(zlib.decompressobj(-zlib.MAX_WBITS), data, FLOAT_BYTES))


def _blocks(path: Path) -> tuple[DepthBlock, ...]:
    """Frames that are compressed one by one; none if the file does not have this form."""
    blocks: list[DepthBlock] = []
    with open_file(path, MAX_FILE_BYTES) as file:
        end = file.seek(0, os.SEEK_END)
        offset = 0
        while offset + 4 < end and len(blocks) < MAX_FRAMES:
            file.seek(offset)
            size = struct.unpack("<I", file.read(4))[0]
            offset += 4
            if not 0 < size <= min(MAX_BLOCK_BYTES, end - offset):
                break
            blocks.append(DepthBlock(path, len(blocks), offset, size))
            offset += size
    if not blocks:
        return ()
    if offset == end:
        return tuple(blocks)
    try:  # truncated, or of the other form, whose first bytes are not a size
        blocks[0].read()
    except InputError:
        return ()
    return tuple(blocks)


def _block(path: Path, offset: int, size: int, whole: bool = True) -> bytes:
    with open_file(path, MAX_FILE_BYTES) as file:
        file.seek(offset)
        data = file.read(size)
    if whole and len(data) < size:
        raise InputError("the file ends within this frame")
    return data


def _inflate(decoder: Any, data: bytes, count: int) -> bytes:
    try:
        found = decoder.decompress(data, count)
    except zlib.error as error:
        raise InputError("damaged depth, it cannot be decompressed") from error
    if len(found) < count:
        raise InputError(f"its depth ends after {len(found)} of {count} bytes")
    return bytes(found)


def _metres(data: bytes) -> Floats32:
    return np.frombuffer(data, "<f4").reshape(HEIGHT, WIDTH).astype(np.float32)


class _Stream:
    """A depth.bin that is one deflate stream; threads take turns."""

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, threading.Lock()
        # By number of frame: the decoder before it, and the position of its remaining input in the file.
        self._states: dict[int, tuple[Any, int, bytes]] = {0: (zlib.decompressobj(-zlib.MAX_WBITS), 0, b"")}
        self._next, self._decoder, self._offset, self._rest = 0, *self._kept(0)

    def frame(self, number: int) -> Floats32:
        """(192, 256) float32 metres. Raises InputError (reason only)."""
        with self._lock, open_file(self._path, MAX_FILE_BYTES) as file:
            start = max(k for k in self._states if k <= number)
            if not start <= self._next <= number:
                self._next, self._decoder, self._offset, self._rest = start, *self._kept(start)
            try:
                while True:
                    data = self._read(file)
                    self._next += 1
                    if self._next % STEP == 0 and self._next not in self._states:
                        self._states[self._next] = (self._decoder.copy(), self._offset, self._rest)
                    if self._next == number + 1:
                        return _metres(data)
            except InputError:
                self._next = -1  # the state of the decoder is unknown now
                raise

    def _kept(self, number: int) -> tuple[Any, int, bytes]:
        decoder, offset, rest = self._states[number]
        return decoder.copy(), offset, rest

    def _read(self, file: BinaryIO) -> bytes:
        """The bytes of the next frame."""
        found = bytearray()
        file.seek(self._offset)
        while len(found) < FLOAT_BYTES:
            if not self._rest:
                self._rest = file.read(READ_BYTES)
                self._offset += len(self._rest)
            if not self._rest or self._decoder.eof:
                raise InputError("the depth of all frames ends before this one")
            try:
                found += self._decoder.decompress(self._rest, FLOAT_BYTES - len(found))
            except zlib.error as error:
                raise InputError("damaged depth, it cannot be decompressed from here on") from error
            self._rest = self._decoder.unconsumed_tail
        return bytes(found)


_STREAMS: KeptOpen[_Stream] = KeptOpen(_Stream)
_FINGERPRINTS: KeptOpen[str] = KeptOpen(file_fingerprint)
