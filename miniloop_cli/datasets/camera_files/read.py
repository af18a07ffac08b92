"""Reading a camera file of any supported format, which is recognised by the content of the file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from miniloop_cli.datasets.camera_files import (
    azure_kinect,
    colmap,
    kalibr,
    nerfstudio,
    open3d,
    opencv,
    orb_slam,
    realsense,
)
from miniloop_cli.datasets.camera_files.fields import Fields, Reading, Size
from miniloop_cli.datasets.camera_files.text import parse_mapping, read_text
from miniloop_cli.datasets.intrinsics import REQUIRED, depth_camera_of, make_camera
from miniloop_cli.datasets.paths import shown
from miniloop_cli.errors import ConfigError, InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import DepthCamera


class Format(NamedTuple):
    """A format of camera files that are mappings."""

    name: str
    matches: Callable[[dict[Any, Any]], bool]
    read: Callable[[Fields], Reading]


class TextFormat(NamedTuple):
    """A format of camera files that are lines of their own kind."""

    name: str
    matches: Callable[[str], bool]
    read: Callable[[str, str, Size | None], Reading]


TEXT_FORMATS = (
    TextFormat("COLMAP's cameras.txt", colmap.matches, colmap.read),
    TextFormat("a listing of rs-enumerate-devices", realsense.matches_listing, realsense.read_listing),
)
# The first that matches is used; formats whose names others use as well come last.
FORMATS = (
    Format("Azure Kinect's calibration.json", azure_kinect.matches_raw, azure_kinect.read_raw),
    Format("Kalibr", kalibr.matches, kalibr.read),
    Format("ORB-SLAM", orb_slam.matches, orb_slam.read),
    Format("nerfstudio's transforms.json", nerfstudio.matches, nerfstudio.read),
    Format("RealSense", realsense.matches, realsense.read),
    Format("Azure Kinect", azure_kinect.matches, azure_kinect.read),
    Format("ROS CameraInfo", opencv.matches_ros, opencv.read_ros),
    Format("Open3D", open3d.matches, open3d.read),
    Format("OpenCV", opencv.matches, opencv.read),
)


def read_camera_file(
    path: Path | str, source: str | None = None, image_size: Size | None = None, depth_scale: float | None = None
) -> Camera:
    """The camera of a file in any of the formats above, or in our own (docs/recordings.md).

    `source` names the origin of the file; `image_size` (width, height) chooses among several cameras;
    `depth_scale` (stored units a metre) is assumed, and reported, if a format of another tool does not state it.

    Raises InputError if the file cannot be read, ConfigError for unknown, missing or impossible values.
    """
    path = path if isinstance(path, Path) else Path(path)
    where, text = shown(path), read_text(path)
    source = source or f"camera file {where}"
    found = _recognise(text, path, where, image_size)
    if isinstance(found, dict):
        return make_camera(found, where, source)
    name, reading = found
    values, notes, assumed = dict(reading.values), [f"read as {name}"], "depth_scale" not in reading.values
    notes += [reading.note] if reading.note else []
    if assumed:
        if depth_scale is None:
            raise ConfigError(
                f"{where}: depth_scale missing; add it: stored units a metre (TUM 5000, millimetres 1000)"
            )
        values["depth_scale"] = depth_scale
        notes.append(f"it states no depth scale: {depth_scale:g} units a metre are assumed")
    return replace(make_camera(values, where, f"{source} ({'; '.join(notes)})"), depth_scale_assumed=assumed)


def read_depth_camera(path: Path, camera: Camera) -> DepthCamera | None:
    """The separate depth camera in the file of the colour `camera`; None if there is none.

    Only our own format has one. Raises as `read_camera_file`.
    """
    found = _recognise(read_text(path), path, shown(path), (camera.width, camera.height))
    return depth_camera_of(found, camera, shown(path)) if isinstance(found, dict) else None


def _recognise(text: str, path: Path, where: str, size: Size | None) -> dict[str, Any] | tuple[str, Reading]:
    """The values of our own format, or the name and the reading of another format."""
    for text_format in TEXT_FORMATS:
        if text_format.matches(text):
            return text_format.name, text_format.read(text, where, size)
    data = parse_mapping(text, path)
    if not isinstance(data, dict):
        raise InputError(f"{where}: expected lines like 'fx: 525.0' ({', '.join(REQUIRED)})")
    for known in FORMATS:
        if known.matches(data):
            return known.name, known.read(Fields(data, where, size))
    return data
