"""MCAP files with messages of ROS 1 or ROS 2, read from the start, so that a truncated file opens as well.

Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from miniloop_cli.datasets.bags.bag import (
    MAX_CHUNK_BYTES,
    MAX_MESSAGE_BYTES,
    Damage,
    Place,
    RecordFile,
    Topic,
    decompressed,
    ros2_type,
)
from miniloop_cli.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 2, 3, 4, 5, 6, 7
RECORD = struct.Struct("<BQ")
CHUNK_START = struct.Struct("<QQQII")  # start, end, size, checksum, length of the compression's name
MESSAGE_START = struct.Struct("<HIQQ")  # channel, sequence, time received, time published
INDEX_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])


class _Chunk(NamedTuple):
    offset: int  # of its records
    stored: int
    size: int
    checksum: int
    compression: str


class McapFile:
    """An open file, with the places of its messages."""

    def __init__(self, path: Path) -> None:
        self._file = RecordFile(path)
        self.topics: dict[str, Topic] = {}
        self.damage = Damage()
        self._chunks: dict[int, _Chunk] = {}
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, Topic | None] = {}
        self._unassigned: list[tuple[int, Place]] = []
        if self._file.at(0, min(len(MAGIC), self._file.size)) != MAGIC:
            raise InputError("not an MCAP file")
        self._walk()
        self._find_channels()
        for channel, place in self._unassigned:
            if topic := self._channels.get(channel):
                topic.places.append(place)
        self._unassigned.clear()
        for topic in self.topics.values():
            topic.places.sort()

    def read(self, place: Place, first: int | None = None) -> bytes:
        if place.inner < 0:
            return self._message(self._file.at, place.record, first)
        chunk = self._chunks[place.record]
        if not chunk.compression:
            return self._message(self._file.at, chunk.offset + place.inner, first)
        data = self._chunk(place.record)

        def at(offset: int, count: int) -> bytes:
            if offset + count > len(data):
                raise InputError(f"a message leads out of the chunk at byte {chunk.offset}")
            return data[offset : offset + count]

        return self._message(at, place.inner, first)

    @staticmethod
    def _message(at: Callable[[int, int], bytes], offset: int, first: int | None) -> bytes:
        kind, size = RECORD.unpack(at(offset, RECORD.size))
        size -= MESSAGE_START.size
        if kind != MESSAGE or not 0 <= size <= MAX_MESSAGE_BYTES:
            raise InputError("no message at its place")
        return at(offset + RECORD.size + MESSAGE_START.size, size if first is None else min(size, first))

    def _chunk(self, offset: int) -> bytes:
        return self._file.chunk(offset, lambda: self._decompressed(self._chunks[offset]))

    def _decompressed(self, chunk: _Chunk) -> bytes:
        data = decompressed(self._file.at(chunk.offset, chunk.stored), chunk.compression, chunk.size)
        if len(data) != chunk.size or (chunk.checksum and zlib.crc32(data) != chunk.checksum):
            raise InputError(f"a damaged chunk at byte {chunk.offset}")
        return data

    def _walk(self) -> None:
        offset, chunk, indexed, ended = len(MAGIC), -1, True, False
        while offset + RECORD.size <= self._file.size:
            kind, size = RECORD.unpack(self._file.at(offset, RECORD.size))
            start = offset + RECORD.size
            try:
                if start + size > self._file.size:
                    raise InputError("the file ends within a record")
                if kind == CHUNK or (kind == FOOTER and chunk >= 0):
                    self._scan_unless(indexed, chunk)
                if kind == CHUNK:
                    chunk, indexed = offset, False
                    self._chunks[chunk] = self._chunk_at(start, size)
                elif kind == MESSAGE_INDEX:
                    indexed = True
                    self._index(chunk, self._file.at(start, size))
                elif kind == MESSAGE:
                    channel, _, time_ns, _ = MESSAGE_START.unpack(self._file.at(start, MESSAGE_START.size))
                    self._unassigned.append((channel, Place(time_ns, offset)))
                elif kind in (SCHEMA, CHANNEL):
                    self._define(kind, self._file.at(start, size))
                elif kind == FOOTER:
                    ended = True
                    break
            except (InputError, ValueError, struct.error):
                self.damage.cut_at = offset
                break
            offset = start + size
        self.damage.unfinished = not ended
        if not ended and self.damage.cut_at is None:
            self.damage.cut_at = offset
        if not ended:
            self._scan_unless(indexed, chunk)

    def _chunk_at(self, start: int, size: int) -> _Chunk:
        _, _, unpacked, checksum, length = CHUNK_START.unpack(self._file.at(start, CHUNK_START.size))
        name = start + CHUNK_START.size
        if length > 100:
            raise InputError("a damaged chunk")
        compression = self._file.at(name, length).decode()
        (stored,) = struct.unpack("<Q", self._file.at(name + length, 8))
        if name + length + 8 + stored > start + size or unpacked > MAX_CHUNK_BYTES:
            raise InputError("a damaged chunk")
        return _Chunk(name + length + 8, stored, unpacked, checksum, compression)

    def _index(self, chunk: int, data: bytes) -> None:
        channel, count = struct.unpack_from("<HI", data)
        if chunk < 0 or 6 + count > len(data) or count % INDEX_ENTRY.itemsize:
            raise InputError("a damaged index")
        found = np.frombuffer(data, INDEX_ENTRY, count // INDEX_ENTRY.itemsize, 6)
        if len(found) and max(found["offset"].max(), found["time"].max()) >= 2**63:
            raise InputError("a damaged index")
        pairs = zip(found["time"].tolist(), found["offset"].tolist(), strict=True)
        self._unassigned += [(channel, Place(time_ns, chunk, inner)) for time_ns, inner in pairs]

    def _scan_unless(self, indexed: bool, chunk: int) -> None:
        """Index the messages of a chunk without an index of its own."""
        if indexed or chunk not in self._chunks:
            return
        data, offset = self._chunk(chunk), 0
        while offset + RECORD.size <= len(data):
            kind, size = RECORD.unpack_from(data, offset)
            start = offset + RECORD.size
            if kind == MESSAGE:
                channel, _, time_ns, _ = MESSAGE_START.unpack_from(data, start)
                self._unassigned.append((channel, Place(time_ns, chunk, offset)))
            elif kind in (SCHEMA, CHANNEL):
                self._define(kind, data[start : start + size])
            offset = start + size

    def _find_channels(self) -> None:
        """Channels of a file without summary are in the chunks, before their first message."""
        seen: set[int] = set()
        for channel, place in self._unassigned:
            if channel in self._channels or place.inner < 0 or place.record in seen:
                continue
            seen.add(place.record)
            try:
                data, offset = self._chunk(place.record), 0
                while offset + RECORD.size <= len(data):
                    kind, size = RECORD.unpack_from(data, offset)
                    start = offset + RECORD.size
                    if kind in (SCHEMA, CHANNEL):
                        self._define(kind, data[start : start + size])
                    offset = start + size
            except (InputError, ValueError, struct.error):
                continue

    def _define(self, kind: int, data: bytes) -> None:
        if kind == SCHEMA:
            (number,) = struct.unpack_from("<H", data)
            self._schemas[number], _ = _string(data, 2)
            return
        number, schema = struct.unpack_from("<HH", data)
        if number in self._channels:
            return
        name, offset = _string(data, 4)
        wire, _ = _string(data, offset)
        kind_name = ros2_type(self._schemas.get(schema, ""))
        topic = self.topics.setdefault(name, Topic(name, kind_name, wire))
        self._channels[number] = topic if (topic.type, topic.wire) == (kind_name, wire) else None


def _string(data: bytes, offset: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", data, offset)
    if offset + 4 + length > len(data):
        raise InputError("a damaged record")
    return data[offset + 4 : offset + 4 + length].decode(), offset + 4 + length
