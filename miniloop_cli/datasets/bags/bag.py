"""The common parts of bag readers: topics, positions of messages, and bounded decompression."""

from __future__ import annotations

import bz2
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Protocol

from miniloop_cli.datasets.damage import damage
from miniloop_cli.errors import InputError

MAX_MESSAGE_BYTES = 256 << 20
MAX_CHUNK_BYTES = 512 << 20
MAX_CACHED_BYTES = 96 << 20  # of decompressed chunks, a bag
MAX_HEADER_BYTES = 1 << 20


class Place(NamedTuple):
    """Position of a message: the file of the bag, the record or row, and the offset within a chunk."""

    time_ns: int  # when it was received
    record: int
    inner: int = -1
    part: int = 0


@dataclass
class Topic:
    """The messages of a topic in the order in which they were received; types as ROS 2 writes them."""

    name: str
    type: str  # sensor_msgs/msg/Image
    wire: str  # how messages are encoded: ros1 or cdr
    places: list[Place] = field(default_factory=list)


@dataclass
class Damage:
    """Damage of a bag."""

    cut_at: int | None = None  # the byte at which reading the records ended
    unfinished: bool = False  # the recorder did not close the file


class Bag(Protocol):
    """An open bag."""

    topics: dict[str, Topic]
    damage: Damage

    def read(self, place: Place, first: int | None = None) -> bytes:
        """A message, or its `first` bytes. Raises InputError (reason only)."""


def ros2_type(name: str) -> str:
    """A message type as ROS 2 writes it, from either form."""
    package, _, kind = name.partition("/")
    return name if "/" in kind or not kind else f"{package}/msg/{kind}"


class RecordFile:
    """A file of records, read by several threads; stated sizes are checked against that of the file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: BinaryIO = path.open("rb")
        self.size = self._file.seek(0, 2)
        self._lock = threading.Lock()
        self._chunks: OrderedDict[int, bytes] = OrderedDict()

    def at(self, offset: int, count: int) -> bytes:
        """`count` bytes. Raises InputError (reason only) if the file ends before."""
        if count < 0 or offset < 0 or offset + count > self.size:
            raise InputError(f"the file ends within the record at byte {offset}")
        with self._lock:
            self._file.seek(offset)
            data = self._file.read(count)
        if len(data) != count:
            raise InputError(f"the file ends within the record at byte {offset}")
        return data

    def chunk(self, offset: int, read: Callable[[], bytes]) -> bytes:
        """The decompressed chunk at `offset`, from the cache or from `read`."""
        with self._lock:
            if offset in self._chunks:
                self._chunks.move_to_end(offset)
                return self._chunks[offset]
        data = read()
        with self._lock:
            self._chunks[offset] = data
            while len(self._chunks) > 1 and sum(map(len, self._chunks.values())) > MAX_CACHED_BYTES:
                self._chunks.popitem(last=False)
        return data


def decompressed(data: bytes, how: str, limit: int) -> bytes:
    """At most `limit` bytes of a compressed chunk. Raises InputError (reason only)."""
    if limit > MAX_CHUNK_BYTES:
        raise InputError(f"a chunk claims {limit / 2**20:.0f} MB, more than the {MAX_CHUNK_BYTES >> 20} MB allowed")
    if how in ("", "none"):
        return data
    with damage(f"a damaged {how} chunk"):
        if how == "bz2":
            return bz2.BZ2Decompressor().decompress(data, limit)
        if how == "lz4":
            return _wheel("lz4").LZ4FrameDecompressor().decompress(data, limit)
        if how == "zstd":
            return _wheel("zstd").ZstdDecompressor().decompress(data, limit)
    raise InputError(f"the compression '{how[:20]}' is not supported")


def _wheel(name: str) -> Any:
    try:
        if name == "lz4":
            import lz4.frame

            return lz4.frame
        from backports import zstd

        return zstd
    except ImportError:
        raise InputError(f"its chunks are compressed by {name}: pip install 'miniloop[bags]'") from None
