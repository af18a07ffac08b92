"""Cameras of a bag: CameraInfo messages, and the transform between two frames by tf."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.bags.bag import Bag, Topic
from miniloop_cli.datasets.bags.topics import ImageTopic
from miniloop_cli.datasets.bags.wire import CAMERA_INFO, TF_MESSAGES, CameraInfo, camera_info, transforms
from miniloop_cli.datasets.camera_files import opencv, realsense
from miniloop_cli.datasets.camera_files.fields import Fields
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.paths import shown
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.typing import Floats

MOST_TRANSFORMS = 300  # messages that are read; static ones come first
MOVED = 1e-6  # of a transform that is not constant
SDK_MODELS = ("conrady", "kannala", "ftheta", "none")


def find_info(path: Path, bag: Bag, image: ImageTopic, given: str | None) -> tuple[str, CameraInfo] | None:
    """The CameraInfo of an image topic: the named one, its neighbour, else the only one of its frame and size.

    Raises InputError where the named topic has none.
    """
    infos = {name: info for name, topic in bag.topics.items() if (info := _first(bag, topic)) is not None}
    if given:
        if given not in infos:
            listed = ", ".join(sorted(infos)) or "none"
            raise InputError(f"{shown(path)}: {shown(given)} has no CameraInfo; topics that have: {shown(listed)}")
        return given, infos[given]
    beside = f"{image.base.rpartition('/')[0]}/camera_info"
    if beside in infos:
        return beside, infos[beside]
    size = (image.head.width, image.head.height)
    fitting = [
        name
        for name, info in infos.items()
        if info.frame == image.head.frame and size in ((0, 0), (info.width, info.height))
    ]
    return (fitting[0], infos[fitting[0]]) if len(fitting) == 1 else None


def _first(bag: Bag, topic: Topic) -> CameraInfo | None:
    if topic.type != CAMERA_INFO:
        return None
    for place in topic.places[:5]:
        try:
            return camera_info(bag.read(place), topic.wire)
        except InputError:
            continue
    return None


def camera_of(info: CameraInfo, where: str, source: str, depth_scale: float, rectified: bool = False) -> Camera:
    """The camera of a CameraInfo; of rectified images, that of its projection matrix without a lens.

    Raises InputError for a camera without calibration, ConfigError for impossible values and unknown lenses.
    """
    K = info.P[:3] + info.P[4:7] + info.P[8:11] if rectified else info.K
    D = () if rectified else info.D
    if K[0] == 0:
        raise InputError(f"{where} describes a camera without calibration (K is 0); give its camera with --camera FILE")
    size = {"width": float(info.width), "height": float(info.height)}
    model = info.model.lower()
    if any(name in model for name in SDK_MODELS) and not rectified:  # RealSense's SDK writes its own names
        named = {"fx": K[0], "fy": K[4], "ppx": K[2], "ppy": K[5], "coeffs": list(D), "model": info.model} | size
        values = realsense.read(Fields(named, where)).values
    else:
        data: dict[str, Any] = {"K": list(K), "D": list(D), "distortion_model": "" if rectified else info.model} | size
        data |= {f"binning_{axis}": float(value) for axis, value in zip("xy", info.binning, strict=True)}
        part = info.roi[2:] not in ((0, 0), (info.height, info.width))
        data["roi"] = {"x_offset": info.roi[0], "y_offset": info.roi[1], "part": int(part)}
        values = opencv.read_ros(Fields(data, where)).values
    return make_camera(values | {"depth_scale": depth_scale}, where, source)


def transform_between(bag: Bag, to: str, of: str) -> Floats | None:
    """(4, 4) T_to_of between two frames, over transforms that do not change; None where they are not connected."""
    links: dict[str, dict[str, Floats]] = {}
    moving: set[tuple[str, str]] = set()
    for topic in sorted(bag.topics.values(), key=lambda topic: "static" not in topic.name):
        if topic.type not in TF_MESSAGES:
            continue
        for place in topic.places[:MOST_TRANSFORMS]:
            try:
                found = transforms(bag.read(place), topic.wire)
            except InputError:
                continue
            for parent, child, T in found:
                known = links.get(parent, {}).get(child)
                if known is not None and np.abs(known - T).max() > MOVED:
                    moving.add((parent, child))
                links.setdefault(parent, {})[child] = T
                links.setdefault(child, {})[parent] = se3.inverse(T)
    for parent, child in moving:
        del links[parent][child], links[child][parent]
    reached, border = {to.lstrip("/"): np.eye(4)}, [to.lstrip("/")]
    while border:
        frame = border.pop(0)
        for other, T in links.get(frame, {}).items():
            if other not in reached:
                reached[other] = reached[frame] @ T
                border.append(other)
    return reached.get(of.lstrip("/"))
