"""Matroska files (.mkv) of whole images: tracks, attachments, tags, and the position of every block.

Only files with independent frames (JPEG, uncompressed) are supported: a frame is then a range of bytes, and neither an
index nor a video decoder is needed. Format: RFC 9559; EBML: RFC 8794.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from miniloop_cli.errors import InputError

MAGIC = b"\x1a\x45\xdf\xa3"
SEGMENT, INFO, TRACKS, CLUSTER, BLOCK_GROUP = 0x18538067, 0x1549A966, 0x1654AE6B, 0x1F43B675, 0xA0
ENTERED = (SEGMENT, INFO, TRACKS, CLUSTER, BLOCK_GROUP, 0x1941A469, 0x1254C367, 0x7373)
SCALE, TIMESTAMP, SIMPLE_BLOCK, BLOCK = 0x2AD7B1, 0xE7, 0xA3, 0xA1
TRACK, ATTACHMENT, TAG = 0xAE, 0x61A7, 0x67C8
NUMBER, NAME, CODEC, PRIVATE, VIDEO, ENCODINGS = 0xD7, 0x536E, 0x86, 0x63A2, 0xE0, 0x6D80
WIDTH, HEIGHT, FOURCC = 0xB0, 0xBA, 0x2EB524
FILE_NAME, FILE_DATA = 0x466E, 0x465C
TAG_NAME, TAG_TEXT = 0x45A3, 0x4487
MAX_ELEMENT_BYTES = 16 << 20  # of a description or an attachment
BITMAP_FOURCC = slice(16, 20)  # of the BITMAPINFOHEADER that describes a track of Video for Windows


@dataclass(frozen=True)
class Track:
    """A track as its entry describes it; `fourcc`: the kind of its images, in capitals."""

    number: int
    name: str
    fourcc: str
    width: int
    height: int
    encoded: bool  # compressed as a whole, which is not supported


@dataclass(frozen=True)
class Block:
    """One frame: the position of its bytes, and its time."""

    track: int
    time_ns: int
    offset: int
    size: int


@dataclass
class Matroska:
    """The content of a file; `cut_at` is the byte from which it is damaged, None if it is whole."""

    tracks: list[Track] = field(default_factory=list)
    blocks: list[Block] = field(default_factory=list)
    attachments: dict[str, bytes] = field(default_factory=dict)
    tags: dict[str, str] = field(default_factory=dict)
    cut_at: int | None = None


def read_matroska(path: Path) -> Matroska:
    """The content of a file, without reading its frames. Raises InputError (reason only) for other files."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(0)
        if file.read(4) != MAGIC:
            raise InputError("not a Matroska file")
        file.seek(0)
        return _walk(file, size)


def _walk(file: BinaryIO, end: int) -> Matroska:
    found, scale, cluster_time = Matroska(), 1_000_000, 0
    while (start := file.tell()) < end:
        try:
            kind, size = _number(file, keep_marker=True), _number(file)
            offset = file.tell()
            if kind in ENTERED:  # also those of unknown size, as their children follow
                continue
            if size < 0 or offset + size > end:
                raise InputError("the file ends within an element")
            if kind in (SIMPLE_BLOCK, BLOCK):
                track = _number(file)
                time, flags = struct.unpack(">hB", file.read(3))
                if flags & 0x06:
                    raise InputError("several frames in a block")
                frame = file.tell()
                if frame > offset + size:
                    raise InputError("a damaged block")
                found.blocks.append(Block(track, (cluster_time + time) * scale, frame, offset + size - frame))
            elif kind == TIMESTAMP:
                cluster_time = _unsigned(file.read(min(size, 8)))
            elif kind == SCALE:
                scale = _unsigned(file.read(min(size, 8)))
            elif kind in (TRACK, ATTACHMENT, TAG):
                if size > MAX_ELEMENT_BYTES:
                    raise InputError("a description of too many bytes")
                _describe(found, kind, _children(file.read(size)))
            file.seek(offset + size)
        except (InputError, struct.error, ValueError, IndexError):
            found.cut_at = start
            break
    return found


def _describe(found: Matroska, kind: int, inner: dict[int, bytes]) -> None:
    if kind == TRACK:
        video = _children(inner.get(VIDEO, b""))
        codec = inner.get(CODEC, b"").rstrip(b"\0")
        fourcc = {b"V_MJPEG": b"MJPG", b"V_UNCOMPRESSED": video.get(FOURCC, b"")}.get(codec, codec)
        if codec == b"V_MS/VFW/FOURCC":
            fourcc = inner.get(PRIVATE, b"")[BITMAP_FOURCC]
        width, height = (_unsigned(video.get(key, b"")) for key in (WIDTH, HEIGHT))
        name = inner.get(NAME, b"").rstrip(b"\0").decode("utf-8", "replace")
        kind_name = fourcc.decode("latin-1").upper()
        encoded = ENCODINGS in inner
        found.tracks.append(Track(_unsigned(inner.get(NUMBER, b"")), name, kind_name, width, height, encoded))
    elif kind == ATTACHMENT and FILE_NAME in inner:
        found.attachments[inner[FILE_NAME].rstrip(b"\0").decode("utf-8", "replace")] = inner.get(FILE_DATA, b"")
    elif kind == TAG and TAG_NAME in inner:
        text = inner.get(TAG_TEXT, b"").rstrip(b"\0").decode("utf-8", "replace")
        found.tags[inner[TAG_NAME].rstrip(b"\0").decode("utf-8", "replace").upper()] = text


def _children(data: bytes) -> dict[int, bytes]:
    """The elements in a description by their kind, the last of each. Raises InputError."""
    import io

    found: dict[int, bytes] = {}
    file = io.BytesIO(data)
    while file.tell() < len(data):
        kind, size = _number(file, keep_marker=True), _number(file)
        if size < 0 or file.tell() + size > len(data):
            raise InputError("a damaged description")
        found[kind] = file.read(size)
    return found


def _number(file: BinaryIO, keep_marker: bool = False) -> int:
    """A number of variable length: an element's kind (with its marker) or size; -1 for an unknown size."""
    first = file.read(1)[0]
    length = 9 - first.bit_length()
    if length > (4 if keep_marker else 8):
        raise InputError("no element")
    rest = file.read(length - 1)
    if len(rest) != length - 1:
        raise InputError("the file ends within an element")
    value = int.from_bytes(bytes([first]) + rest, "big")
    if keep_marker:
        return value
    mask = (1 << (7 * length)) - 1
    return -1 if value & mask == mask else value & mask


def _unsigned(data: bytes) -> int:
    return int.from_bytes(data[:8], "big")
