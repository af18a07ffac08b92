"""ROS 1 bags (format 2.0): chunks of records, read from the start, so that a truncated bag opens as well.

Format: https://wiki.ros.org/Bags/Format/2.0. The recorder writes an index after each chunk; a bag that was not closed
(`.active`) lacks only the last one.
"""

from __future__ import annotations

import struct
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from miniloop_cli.datasets.bags.bag import (
    MAX_HEADER_BYTES,
    MAX_MESSAGE_BYTES,
    Damage,
    Place,
    RecordFile,
    Topic,
    decompressed,
    ros2_type,
)
from miniloop_cli.errors import InputError

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CONNECTION = 2, 3, 4, 5, 7
INDEX_ENTRY = np.dtype([("s", "<u4"), ("ns", "<u4"), ("offset", "<u4")])
Header = dict[bytes, bytes]


class _Chunk(NamedTuple):
    offset: int  # of its data
    stored: int
    size: int
    compression: str


class Ros1Bag:
    """An open bag, with the places of its messages."""

    def __init__(self, path: Path) -> None:
        self._file = RecordFile(path)
        self.topics: dict[str, Topic] = {}
        self.damage = Damage()
        self._chunks: dict[int, _Chunk] = {}
        self._connections: dict[int, Topic | None] = {}
        self._index: list[tuple[int, int, bytes]] = []  # connection, chunk, entries
        if self._file.at(0, min(len(MAGIC), self._file.size)) != MAGIC:
            raise InputError("not a ROS bag of format 2.0")
        self._walk()
        self._find_connections()
        for connection, chunk, entries in self._index:
            topic = self._connections.get(connection)
            if topic is None:
                continue
            found = np.frombuffer(entries, INDEX_ENTRY)
            times = found["s"].astype(np.int64) * 10**9 + found["ns"]
            places = zip(times.tolist(), found["offset"].tolist(), strict=True)
            topic.places += [Place(time_ns, chunk, offset) for time_ns, offset in places]
        self._index.clear()
        for topic in self.topics.values():
            topic.places.sort()

    def read(self, place: Place, first: int | None = None) -> bytes:
        chunk = self._chunks[place.record]
        data = None
        if chunk.compression != "none":
            data = self._file.chunk(place.record, lambda: self._decompressed(chunk))

        def at(offset: int, count: int) -> bytes:
            if offset < 0 or count < 0 or offset + count > chunk.size:
                raise InputError(f"a message leads out of the chunk at byte {chunk.offset}")
            return self._file.at(chunk.offset + offset, count) if data is None else data[offset : offset + count]

        offset = place.inner
        while True:  # a connection may precede its first message
            length = _u32(at(offset, 4))
            header = _fields(at(offset + 4, length))
            start = offset + 8 + length
            size = _u32(at(start - 4, 4))
            if header.get(b"op") == bytes([MESSAGE]):
                break
            if header.get(b"op") != bytes([CONNECTION]):
                raise InputError(f"no message at its place in the chunk at byte {chunk.offset}")
            offset = start + size
        if size > MAX_MESSAGE_BYTES:
            raise InputError(f"a message of {size / 2**20:.0f} MB")
        return at(start, size if first is None else min(size, first))

    def _decompressed(self, chunk: _Chunk) -> bytes:
        data = decompressed(self._file.at(chunk.offset, chunk.stored), chunk.compression, chunk.size)
        if len(data) != chunk.size:
            raise InputError(f"a damaged chunk at byte {chunk.offset}")
        return data

    def _walk(self) -> None:
        """Read all records except the content of chunks, up to the first incomplete record."""
        offset, chunk = len(MAGIC), -1
        while offset < self._file.size:
            try:
                length = _u32(self._file.at(offset, 4))
                if length > MAX_HEADER_BYTES:
                    raise InputError("no record")
                header = _fields(self._file.at(offset + 4, length))
                start = offset + 8 + length
                size = _u32(self._file.at(start - 4, 4))
                kind = header.get(b"op", b"\0")[0]
                if start + size > self._file.size:
                    raise InputError("the file ends within a record")
                if kind == CHUNK:
                    compression = header[b"compression"].decode()
                    unpacked = _u32(header[b"size"])
                    chunk = offset
                    self._chunks[chunk] = _Chunk(start, size, unpacked, compression)
                elif kind == INDEX and chunk >= 0:
                    entries = self._file.at(start, size)
                    self._index.append((_u32(header[b"conn"]), chunk, entries[: len(entries) // 12 * 12]))
                elif kind == CONNECTION:
                    self._connect(header, self._file.at(start, size))
                elif kind == BAG_HEADER:
                    self.damage.unfinished = struct.unpack("<Q", header[b"index_pos"])[0] == 0
                    if header.get(b"encryptor"):
                        raise InputError(
                            "the bag is encrypted, which is not supported; write it again without encryption"
                        )
            except (InputError, KeyError, ValueError, struct.error) as error:
                if "encrypted" in str(error):
                    raise
                self.damage.cut_at = offset
                return
            offset = start + size

    def _find_connections(self) -> None:
        """Connections of a bag without an index at its end are in the chunks, before their first message."""
        for connection, offset, _ in self._index:
            if connection in self._connections:
                continue
            chunk = self._chunks[offset]
            self._connections[connection] = None
            try:
                data = self._file.chunk(offset, partial(self._decompressed, chunk))
                self._connections_in(data)
            except (InputError, KeyError, ValueError, struct.error):
                continue

    def _connections_in(self, data: bytes) -> None:
        offset = 0
        while offset + 8 <= len(data):
            length = _u32(data[offset : offset + 4])
            header = _fields(data[offset + 4 : offset + 4 + length])
            start = offset + 8 + length
            size = _u32(data[start - 4 : start])
            if header.get(b"op") == bytes([CONNECTION]):
                self._connect(header, data[start : start + size])
            offset = start + size

    def _connect(self, header: Header, data: bytes) -> None:
        inner = _fields(data)
        number = _u32(header[b"conn"])
        if self._connections.get(number) is not None:
            return
        name, kind = header[b"topic"].decode(), ros2_type(inner[b"type"].decode())
        name = "/" + name.strip("/")
        topic = self.topics.setdefault(name, Topic(name, kind, "ros1"))
        self._connections[number] = topic if topic.type == kind else None


def _u32(data: bytes) -> int:
    return int(struct.unpack("<I", data)[0])


def _fields(data: bytes) -> Header:
    """The fields `name=value` of a header. Raises InputError (reason only)."""
    found: Header = {}
    offset = 0
    while offset < len(data):
        size = _u32(data[offset : offset + 4])
        name, equals, value = data[offset + 4 : offset + 4 + size].partition(b"=")
        if not equals or offset + 4 + size > len(data):
            raise InputError("a damaged record")
        found[name] = value
        offset += 4 + size
    return found
