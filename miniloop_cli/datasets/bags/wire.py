"""Decoding of ROS messages: images, cameras and transforms, in the encoding of ROS 1 and in CDR (ROS 2).

Both encodings list the fields in order. CDR begins with four bytes that give the byte order, aligns each number to
its size, and ends strings by a zero; a ROS 1 header also has a counter.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from miniloop_cli.datasets.bags.bag import Topic
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.typing import Floats

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TF_MESSAGES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
TRANSFORM, FLOAT32 = "geometry_msgs/msg/Transform", "std_msgs/msg/Float32"
WIRES = ("ros1", "cdr")
HEAD_BYTES = 1024  # enough for the header and description of an image with names of usual length
MAX_TEXT, MAX_ITEMS = 4096, 10_000


class Cursor:
    """Reads fields in order. Raises InputError (reason only) if the message is too short."""

    def __init__(self, data: bytes, wire: str) -> None:
        self._data, self._aligned = data, wire == "cdr"
        self._order, self.at = "<", 0
        if wire not in WIRES:
            raise InputError(f"the message encoding '{wire[:20]}' is not supported")
        if self._aligned:
            if data[:2] not in (b"\0\0", b"\0\1"):
                raise InputError("the message is damaged or not in plain CDR")
            self._order, self.at = "><"[data[1]], 4

    def numbers(self, kind: str, count: int = 1) -> list:
        """`count` numbers of a type of `struct`. Raises InputError as the class."""
        size = struct.calcsize(f"={kind}")
        if self._aligned and count:
            self.at += -(self.at - 4) % size
        end = self.at + count * size
        if count > MAX_ITEMS or end > len(self._data):
            raise InputError("the message ends too early")
        found = struct.unpack_from(f"{self._order}{count}{kind}", self._data, self.at)
        self.at = end
        return list(found)

    def number(self, kind: str) -> int:
        """One whole number."""
        return int(self.numbers(kind)[0])

    def text(self) -> str:
        """A string. Raises InputError as the class."""
        length = self.number("I")
        if length > MAX_TEXT or self.at + length > len(self._data):
            raise InputError("the message ends too early")
        found = self._data[self.at : self.at + length]
        self.at += length
        return found.rstrip(b"\0").decode("utf-8", "backslashreplace")

    def header(self) -> tuple[int, str]:
        """Stamp (ns) and frame of a std_msgs/Header."""
        if not self._aligned:
            self.numbers("I")
        seconds, nanoseconds = self.numbers("i" if self._aligned else "I")[0], self.number("I")
        return seconds * 10**9 + nanoseconds, self.text()

    def rest(self) -> bytes:
        """The bytes of a sequence of uint8 of the stated length. Raises InputError as the class."""
        length = self.number("I")
        if self.at + length > len(self._data):
            raise InputError("the message ends before its image")
        return self._data[self.at : self.at + length]


@dataclass(frozen=True)
class ImageHead:
    """The fields of an image message before its pixels; of a compressed one, `encoding` is its format."""

    stamp_ns: int
    frame: str
    encoding: str
    height: int = 0
    width: int = 0
    big_endian: bool = False
    step: int = 0


def image_head(data: bytes, topic: Topic) -> tuple[ImageHead, Cursor]:
    """The head of an Image or CompressedImage, and the cursor at its pixels."""
    cursor = Cursor(data, topic.wire)
    stamp_ns, frame = cursor.header()
    if topic.type == COMPRESSED:
        return ImageHead(stamp_ns, frame, cursor.text()), cursor
    height, width = cursor.numbers("I", 2)
    encoding = cursor.text()
    big_endian = cursor.number("B") != 0
    return ImageHead(stamp_ns, frame, encoding, height, width, big_endian, cursor.number("I")), cursor


@dataclass(frozen=True)
class CameraInfo:
    """The used fields of a sensor_msgs/CameraInfo."""

    frame: str
    height: int
    width: int
    model: str
    D: tuple[float, ...]
    K: tuple[float, ...]
    P: tuple[float, ...]
    binning: tuple[int, ...]
    roi: tuple[int, ...]  # x, y, height, width


def camera_info(data: bytes, wire: str) -> CameraInfo:
    """A decoded CameraInfo. Raises InputError (reason only)."""
    cursor = Cursor(data, wire)
    _, frame = cursor.header()
    height, width = cursor.numbers("I", 2)
    model = cursor.text()
    D = cursor.numbers("d", cursor.number("I"))
    K, _, P = cursor.numbers("d", 9), cursor.numbers("d", 9), cursor.numbers("d", 12)
    binning, roi = cursor.numbers("I", 2), cursor.numbers("I", 4)
    return CameraInfo(frame, height, width, model, tuple(D), tuple(K), tuple(P), tuple(binning), tuple(roi))


def transforms(data: bytes, wire: str) -> list[tuple[str, str, Floats]]:
    """Parent frame, child frame and (4, 4) T_parent_child of each transform of a TFMessage."""
    cursor, found = Cursor(data, wire), []
    for _ in range(min(cursor.number("I"), MAX_ITEMS)):
        _, parent = cursor.header()
        child = cursor.text()
        found.append((parent.lstrip("/"), child.lstrip("/"), _pose(cursor)))
    return found


def transform(data: bytes, wire: str) -> Floats:
    """(4, 4) of a geometry_msgs/Transform."""
    return _pose(Cursor(data, wire))


def float32(data: bytes, wire: str) -> float:
    """A std_msgs/Float32."""
    return float(Cursor(data, wire).numbers("f")[0])


def _pose(cursor: Cursor) -> Floats:
    t, q = np.array(cursor.numbers("d", 3)), np.array(cursor.numbers("d", 4))
    norm = np.linalg.norm(q)
    if not (np.isfinite(t).all() and abs(norm - 1) < 0.02):
        raise InputError("a transform is not a rigid motion")
    return se3.pose(se3.rotations(q / norm), t)
