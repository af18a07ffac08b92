"""ROS 2 bags: SQLite files, and the folder of a recording with its metadata.yaml and one file or several."""

from __future__ import annotations

import sqlite3
import threading
from pathlib import Path
from urllib.parse import quote

from miniloop_cli.datasets.bags.bag import (
    MAX_MESSAGE_BYTES,
    Bag,
    Damage,
    Place,
    Topic,
    decompressed,
    ros2_type,
)
from miniloop_cli.datasets.bags.mcap import McapFile
from miniloop_cli.datasets.paths import read_bytes, shown, within
from miniloop_cli.errors import InputError
from miniloop_cli.runtime.safe_yaml import load_plain

SQLITE = b"SQLite format 3\0"
METADATA = "metadata.yaml"


class SqliteBag:
    """An open .db3 file; a message is a row, whose first bytes are read without the rest."""

    def __init__(self, path: Path) -> None:
        self.topics: dict[str, Topic] = {}
        self.damage = Damage()
        self._lock = threading.Lock()
        try:
            uri = f"file:{quote(str(path))}?mode=ro&immutable=1"
            self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
            topics = {}
            for number, name, kind, wire in self._rows("SELECT id, name, type, serialization_format FROM topics"):
                topics[number] = Topic(str(name), ros2_type(str(kind)), str(wire))
            for number, row, time_ns in self._rows("SELECT topic_id, id, timestamp FROM messages ORDER BY timestamp"):
                if number in topics and isinstance(row, int) and isinstance(time_ns, int):
                    topics[number].places.append(Place(time_ns, row))
        except sqlite3.Error as error:
            raise InputError(f"a damaged ROS 2 bag, or another database: {shown(str(error))}") from error
        for topic in topics.values():
            if topic.name in self.topics:
                raise InputError(f"two topics are called {shown(topic.name)}")
            self.topics[topic.name] = topic

    def _rows(self, query: str) -> sqlite3.Cursor:
        return self._database.execute(query)

    def read(self, place: Place, first: int | None = None) -> bytes:
        try:
            with self._lock, self._database.blobopen("messages", "data", place.record, readonly=True) as blob:
                if len(blob) > MAX_MESSAGE_BYTES:
                    raise InputError(f"a message of {len(blob) / 2**20:.0f} MB")
                return blob.read(len(blob) if first is None else min(first, len(blob)))
        except (sqlite3.Error, ValueError, OverflowError) as error:
            raise InputError(f"a damaged message: {shown(str(error))}") from error


class Ros2Folder:
    """The files of a recording as one bag."""

    def __init__(self, folder: Path) -> None:
        self.topics: dict[str, Topic] = {}
        self.damage = Damage()
        self._by_message = False
        self._parts: list[Bag] = []
        for path in self._paths(folder):
            try:
                part: Bag = McapFile(path) if path.suffix.lower() == ".mcap" else SqliteBag(path)
            except InputError as error:
                raise InputError(f"{shown(path.name)}: {error}") from None
            number = len(self._parts)
            self._parts.append(part)
            if part.damage.cut_at is not None or part.damage.unfinished:
                self.damage = part.damage
            for name, topic in part.topics.items():
                whole = self.topics.setdefault(name, Topic(name, topic.type, topic.wire))
                if (whole.type, whole.wire) != (topic.type, topic.wire):
                    raise InputError(f"topic {shown(name)} has two types")
                whole.places += [place._replace(part=number) for place in topic.places]
        for topic in self.topics.values():
            topic.places.sort()

    def read(self, place: Place, first: int | None = None) -> bytes:
        part = self._parts[place.part]
        if self._by_message:
            return decompressed(part.read(place), "zstd", MAX_MESSAGE_BYTES if first is None else first)
        return part.read(place, first)

    def _paths(self, folder: Path) -> list[Path]:
        metadata = folder / METADATA
        if not metadata.is_file():
            paths = storage_files(folder)
            if len(paths) != 1:
                raise InputError(f"{len(paths)} bag files and no {METADATA} that orders them; give one of the files")
            return paths
        import yaml

        try:
            data = load_plain(read_bytes(metadata).decode("utf-8"))
            data = data["rosbag2_bagfile_information"]
            names = [str(name) for name in data["relative_file_paths"]]
            how, what = str(data.get("compression_mode") or "").lower(), str(data.get("compression_format") or "")
        except (yaml.YAMLError, KeyError, TypeError, AttributeError, ValueError) as error:
            raise InputError(f"{METADATA} does not describe a ROS 2 bag ({type(error).__name__})") from None
        if how == "file":
            raise InputError("its files are compressed as a whole: unpack them (`ros2 bag convert`, or `zstd -d`)")
        if how == "message" and what != "zstd":
            raise InputError(f"the compression '{what[:20]}' of its messages is not supported")
        self._by_message = how == "message"
        # Early versions wrote the name of the folder before each file.
        paths = [within(folder, Path(name).name, f"{METADATA}") for name in names]
        if missing := next((path for path in paths if not path.is_file()), None):
            raise InputError(f"{METADATA} names {shown(missing.name)}, which does not exist")
        if not paths:
            raise InputError(f"{METADATA} names no file")
        return paths


def storage_files(folder: Path) -> list[Path]:
    """The bag files in a folder."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in (".db3", ".mcap") and path.is_file())
