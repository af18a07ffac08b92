"""Recordings of RealSense's SDK and viewer: ROS 1 bags with topics of their own; depth is not registered to colour.

/device_0/sensor_0/Depth_0/image/data with .../info/camera_info and .../tf/0, and, for the sensor, the unit of depth as
/device_0/sensor_0/option/Depth_Units/value (librealsense, src/media/ros/ros_file_format.h). A transform maps points of
the reference stream, whose number ends the topic, to those of its own stream.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np

from miniloop_cli.datasets.archive_path import ArchivePath
from miniloop_cli.datasets.bags.bag import Bag, Topic
from miniloop_cli.datasets.bags.cameras import camera_of
from miniloop_cli.datasets.bags.source import looks_like_bag, open_bag
from miniloop_cli.datasets.bags.streams import damage_notes, stamped_streams
from miniloop_cli.datasets.bags.wire import FLOAT32, TRANSFORM, camera_info, float32, transform
from miniloop_cli.datasets.numbered import given_camera
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import shown
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import DepthCamera, Note, NoteKind, Sequence, Trajectory
from miniloop_cli.typing import Floats

T = TypeVar("T")
IMAGES = re.compile(r"(/device_\d+/sensor_\d+)/(Depth|Color)_\d+/image/data")
PLAUSIBLE_UNITS_M = (1e-6, 0.1)


class RealSenseBag:
    """RealSense .bag: /device_0/..., depth in the recorded unit, registered by the recorded calibration."""

    topics: Mapping[str, str] = {}

    def matches(self, root: Path) -> bool:
        """By the topics of the bag."""
        if isinstance(root, ArchivePath) or root.is_dir() or not looks_like_bag(root):
            return False
        try:
            return any(IMAGES.fullmatch(name) for name in open_bag(root).topics)
        except InputError:
            return False

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in the bag. Raises InputError naming what it lacks."""
        bag = open_bag(root)
        color, depth = self._topic(root, bag, "color"), self._topic(root, bag, "depth")
        pairs = pair(root, *stamped_streams(root, color, depth))
        scale = _depth_scale(root, bag, depth)
        given = given_camera(root, camera_path, pairs.frames)
        if scale is None and (given is None or given.depth_scale_assumed):
            raise InputError(f"{shown(root)} lacks {_option(depth)}, the unit of depth; state it with --camera FILE")
        scale = scale or (given.depth_scale if given else 0.0)
        camera = given or self._camera(root, bag, color, scale)
        T = _transform(root, bag, color, depth)
        own = DepthCamera(self._camera(root, bag, depth, scale), tuple(T.ravel().tolist()))
        text = (
            f"depth of {1000 / scale:g} mm a unit is registered to colour by the recorded calibration of both cameras"
        )
        notes = (*damage_notes(root, bag), *pairs.notes, Note(NoteKind.CONVERTED, text))
        return Sequence(
            root.stem,
            root,
            camera,
            pairs.frames,
            notes=notes,
            available=pairs.available,
            depth_camera=own,
            color_only=pairs.color_only,
        )

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """None."""
        return None

    def _topic(self, root: Path, bag: Bag, role: str) -> Topic:
        if name := self.topics.get(role):
            if name not in bag.topics or not IMAGES.fullmatch(name):
                listed = ", ".join(sorted(filter(IMAGES.fullmatch, bag.topics)))
                raise InputError(f"{shown(root)} has no topic of images {shown(name)}; it has {listed}")
            return bag.topics[name]
        found = [t for name, t in bag.topics.items() if (m := IMAGES.fullmatch(name)) and m[2].lower() == role]
        if len(found) != 1:
            names = ", ".join(sorted(topic.name for topic in found)) or "none"
            raise InputError(
                f"{shown(root)} has {len(found)} streams of {role} ({names}); choose one by --topics {role}=NAME"
            )
        return found[0]

    def _camera(self, root: Path, bag: Bag, image: Topic, depth_scale: float) -> Camera:
        name = f"{image.name.removesuffix('/image/data')}/info/camera_info"
        topic = bag.topics.get(name)
        if topic is None or not topic.places:
            raise InputError(f"{shown(root)} lacks {name}, the camera of {image.name}")
        info = _message(root, bag, topic, camera_info)
        return camera_of(info, f"{shown(root)}{name}", f"the bag's own {name}", depth_scale)


def _message(root: Path, bag: Bag, topic: Topic, parse: Callable[[bytes, str], T]) -> T:
    """The first message of a topic. Raises InputError that names both."""
    try:
        return parse(bag.read(topic.places[0]), topic.wire)
    except InputError as error:
        raise InputError(f"{shown(root)}: {topic.name}: {error}") from None


def _option(depth: Topic) -> str:
    match = IMAGES.fullmatch(depth.name)
    return f"{match[1] if match else ''}/option/Depth_Units/value"


def _depth_scale(root: Path, bag: Bag, depth: Topic) -> float | None:
    """Stored units a metre, None if the bag does not state them. Raises InputError for an impossible unit."""
    topic = bag.topics.get(_option(depth)) or bag.topics.get(_option(depth).replace("_Units", " Units"))
    if topic is None or topic.type != FLOAT32 or not topic.places:
        return None
    unit_m = _message(root, bag, topic, float32)
    if not PLAUSIBLE_UNITS_M[0] <= unit_m <= PLAUSIBLE_UNITS_M[1]:
        raise InputError(f"{shown(root)}: {topic.name} is {unit_m:g} m, which cannot be a unit of depth")
    return float(f"{1 / unit_m:.6g}")  # the unit is a 32-bit float


def _transform(root: Path, bag: Bag, color: Topic, depth: Topic) -> Floats:
    """(4, 4) T_color_depth over the reference that both streams share."""
    ways: list[dict[str, Floats]] = []
    for image in (color, depth):
        start = f"{image.name.removesuffix('/image/data')}/tf/"
        found = {
            name.removeprefix(start): _message(root, bag, topic, transform)
            for name, topic in bag.topics.items()
            if name.startswith(start) and topic.type == TRANSFORM and topic.places
        }
        if not found:
            raise InputError(f"{shown(root)} lacks {start}0, the pose of {image.name} on the device")
        ways.append(found)
    common = sorted(ways[0].keys() & ways[1].keys())
    if not common:
        raise InputError(f"{shown(root)}: the transforms of colour and depth (tf) have no reference in common")
    return np.asarray(ways[0][common[0]] @ se3.inverse(ways[1][common[0]]))
