"""Common parts of layouts: images paired by frame number, a given camera, poses and cameras in small files."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.camera_files import read_camera_file
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import read_bytes, read_lines, shown
from miniloop_cli.datasets.stream import RATE_HZ, Stream, stamped_files
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import Frame, Note, Trajectory
from miniloop_cli.typing import Floats

MAX_JSON_BYTES = 64 << 20


def frame_number(name: str) -> int | None:
    """The first number in a file's name ("frame-000012.pose.txt": 12), None without one."""
    match = re.search(r"\d{1,18}", name)
    return int(match[0]) if match else None


def pair_by_number(
    root: Path, color: Mapping[int, ImageSource], depth: Mapping[int, ImageSource], rate_hz: float = RATE_HZ
) -> tuple[tuple[Frame, ...], tuple[Note, ...], tuple[int, int]]:
    """Frames with both images, with stamps of `rate_hz` frames a second; notes; numbers of colour and depth images.

    Raises InputError if there are none.
    """
    found = pair(root, _counted("colour", color), _counted("depth", depth), rate_hz=rate_hz)
    return found.frames, found.notes, found.available


def _counted(what: str, images: Mapping[int, ImageSource]) -> Stream:
    order = sorted(images)
    sources = tuple(images[k] for k in order)
    return Stream(what, sources, tuple(source.name for source in sources), np.array(order, np.int64))


def given_camera(
    root: Path, camera_path: Path | None, frames: tuple[Frame, ...], depth_scale: float = 1000.0
) -> Camera | None:
    """The camera file given by the user, or camera.yaml in the recording; None leaves it to the layout.

    `frames` give the images' size, which chooses among several cameras in a file; `depth_scale` (units a metre) is the
    layout's, for files of other tools that do not state it.
    """
    path = camera_path or root / "camera.yaml"
    if camera_path is None and not path.exists():
        return None
    source = None if camera_path else "the sequence's own camera.yaml"
    return read_camera_file(path, source, color_size(frames), depth_scale)


def color_size(frames: tuple[Frame, ...]) -> tuple[int, int] | None:
    """Width and height (px) of the first readable colour image of the first twenty; None if there is none."""
    for frame in frames[:20]:
        try:
            header = frame.color.header()
        except InputError:
            continue
        return header.width, header.height
    return None


def read_matrix(path: Path, shape: tuple[int, int]) -> Floats:
    """A matrix (rows, columns) from a text file; NaN and infinity allowed. Raises InputError naming the file."""
    try:
        values = [float(text) for _, line in read_lines(path) for text in line.replace(",", " ").split()]
    except ValueError:
        raise InputError(f"{shown(path)}: not a matrix of numbers") from None
    if len(values) != shape[0] * shape[1]:
        raise InputError(f"{shown(path)}: expected {shape[0]} x {shape[1]} numbers, found {len(values)}")
    return np.array(values).reshape(shape)


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object. Raises InputError naming the file (and line) for anything else."""
    try:
        data = json.loads(read_bytes(path, MAX_JSON_BYTES).decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise InputError(f"{shown(path)}:{error.lineno}: not JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{shown(path)}: not JSON: {type(error).__name__}") from None
    if not isinstance(data, dict):
        raise InputError(f"{shown(path)}: expected a JSON object")
    return data


def numbers(value: Any, count: int, where: str) -> Floats:
    """A (nested) JSON list of numbers as an array (count,). Raises InputError naming `where`."""
    try:
        array = np.asarray(value, float).ravel()
    except (ValueError, TypeError, OverflowError):
        array = np.zeros(0)
    if array.size != count:
        raise InputError(f"{where}: expected {count} numbers")
    return array


def usable_pose(T: Floats, where: str) -> Floats | None:
    """A (4, 4) pose with an exact rotation; None if it is not finite, which marks a frame without a pose.

    Raises InputError naming `where` if it is not a rigid transformation.
    """
    if not np.isfinite(T).all():
        return None
    R = T[:3, :3]
    if np.abs(T).max() > 1e7 or np.abs(R @ R.T - np.eye(3)).max() > 0.01 or np.linalg.det(R) < 0:
        raise InputError(f"{where}: not a rigid transformation (rotation and position in metres, camera to world)")
    return se3.pose(se3.project_so3(R), T[:3, 3])


def trajectory_of(poses: Mapping[float, Floats | None], where: str) -> Trajectory:
    """Poses (4, 4) by stamp, frames without one left out. Raises InputError naming `where` if none is left."""
    known = {stamp: T for stamp, T in sorted(poses.items()) if T is not None}
    if not known:
        raise InputError(f"{where}: no frame has a pose")
    return Trajectory(np.array(list(known)), np.array(list(known.values())))


def poses_in_files(root: Path, folder: str, suffix: str) -> Trajectory:
    """The poses of a sub-folder's files, one matrix (4, 4) a frame, named like the images. Raises InputError."""
    files = stamped_files(root, folder, (suffix,))
    poses = {stamp: usable_pose(read_matrix(path, (4, 4)), shown(path)) for stamp, path in files.items()}
    return trajectory_of(poses, shown(root / folder))
