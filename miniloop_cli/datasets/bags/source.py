"""The image source of a message in a bag, and bags kept open."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from miniloop_cli.datasets.bags.bag import Bag, Place, Topic
from miniloop_cli.datasets.bags.mcap import MAGIC as MCAP_MAGIC
from miniloop_cli.datasets.bags.mcap import McapFile
from miniloop_cli.datasets.bags.pixels import compressed_header, compressed_pixels, raw_header, raw_pixels
from miniloop_cli.datasets.bags.ros1 import MAGIC as ROS1_MAGIC
from miniloop_cli.datasets.bags.ros1 import Ros1Bag
from miniloop_cli.datasets.bags.ros2 import SQLITE, Ros2Folder, SqliteBag
from miniloop_cli.datasets.bags.wire import COMPRESSED, HEAD_BYTES, ImageHead, image_head
from miniloop_cli.datasets.paths import shown
from miniloop_cli.errors import InputError, out_of_memory
from miniloop_cli.runtime.kept_open import KeptOpen
from miniloop_cli.scene.image_source import ImageHeader

IN_FOLDER = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
START_BYTES = 1 << 16  # of a compressed image, enough for its header


@dataclass(frozen=True)
class BagImage:
    """An Image or CompressedImage of a bag, by its position; each process opens the bag itself."""

    path: Path
    topic: str
    type: str
    wire: str
    place: Place

    @property
    def name(self) -> str:
        return f"{os.fspath(self.path)}{self.topic}/{self.place.time_ns}"

    def head(self) -> ImageHead:
        """Stamp, frame and encoding. Raises InputError (reason only)."""
        return self._parts(HEAD_BYTES)[0]

    def header(self) -> ImageHeader:
        if self.type != COMPRESSED:
            return raw_header(self.head())
        head, data = self._parts(START_BYTES)
        try:
            return compressed_header(head, self.topic, data)
        except InputError:
            head, data = self._parts(None)
            return compressed_header(head, self.topic, data)

    def read(self) -> NDArray[Any]:
        head, data = self._parts(None)
        if self.type == COMPRESSED:
            return compressed_pixels(head, self.topic, data)
        return raw_pixels(head, data)

    def fingerprint(self) -> str:
        try:
            return hashlib.sha256(open_bag(self.path).read(self.place)).hexdigest()
        except InputError:
            return "unreadable"

    def _parts(self, first: int | None) -> tuple[ImageHead, bytes]:
        """Head, and the part of the pixels in the `first` bytes of the message."""
        data = open_bag(self.path).read(self.place, first)
        head, cursor = image_head(data, Topic(self.topic, self.type, self.wire))
        if first is None:
            return head, cursor.rest()
        return head, data[cursor.at + 4 :]


def looks_like_bag(path: Path) -> bool:
    """Whether a file is a bag by its suffix and first bytes, or a folder by its files."""
    if path.is_dir():
        return any(child.name.lower().endswith(IN_FOLDER) and child.is_file() for child in path.iterdir())
    return path.suffix.lower() in (".bag", ".db3", ".mcap", ".active") and path.is_file()


def open_bag(path: Path) -> Bag:
    """The bag at `path`, kept open. Raises InputError that names it."""
    try:
        return _KEPT.get(path)
    except OSError as error:
        raise InputError(f"cannot read {shown(path)}: {error.strerror or error}") from error


def _open(path: Path) -> Bag:
    try:
        if path.is_dir():
            return Ros2Folder(path)
        with path.open("rb") as file:
            start = file.read(16)
        if start == SQLITE:
            return SqliteBag(path)
        if start.startswith(MCAP_MAGIC):
            return McapFile(path)
        if start.startswith(ROS1_MAGIC):
            return Ros1Bag(path)
        if start.startswith(b"#ROSBAG"):
            raise InputError("a ROS bag of a format other than 2.0: convert it with `rosbag fix`")
        raise InputError("empty" if not start else "neither a ROS bag nor an MCAP file")
    except InputError as error:
        raise InputError(f"{shown(path)}: {error}") from None
    except OSError:
        raise
    except Exception as error:  # damage that no check covers
        if out_of_memory(error):
            raise
        raise InputError(f"{shown(path)} is damaged ({type(error).__name__})") from error


_KEPT: KeptOpen[Bag] = KeptOpen(_open)
