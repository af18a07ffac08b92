"""Poses of images by name, from other tools: a model of COLMAP (text or binary), nerfstudio's transforms.json.

COLMAP: world to camera, quaternion w x y z (colmap.github.io/format.html). nerfstudio: camera to world in OpenGL's
axes (docs.nerf.studio, data conventions).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from miniloop_cli.datasets.numbered import numbers, read_json, usable_pose
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.trajectory import from_rows
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.conventions import OPENGL_AXES
from miniloop_cli.scene.interpolation import nearest
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Floats

COLMAP_FILES = ("images.bin", "images.txt")
COLMAP_FOLDERS = (".", "sparse/0", "sparse")
HEAD = struct.Struct("<I7dI")  # image id, qw qx qy qz tx ty tz, camera id; then the name and a zero
POINT_BYTES = 24  # x, y and the number of the 3D point
SAME_STAMP_S = 1e-3
LEAST = 3  # poses, for an alignment


@dataclass(frozen=True)
class NamedPoses:
    """(n, 4, 4) T_world_cam of images by name, in any unit; `source` names their origin."""

    names: tuple[str, ...]
    T_world_cam: Floats
    source: str


def read_named_poses(path: Path) -> NamedPoses | None:
    """The poses of a COLMAP model (its folder or images file) or of a transforms.json; None for anything else.

    Raises InputError if such a file is damaged.
    """
    if path.is_dir():
        places = [path / folder / name for folder in COLMAP_FOLDERS for name in COLMAP_FILES]
        file = next((place for place in [*places, path / "transforms.json"] if place.is_file()), None)
        return read_named_poses(file) if file else None
    if path.name == "images.bin":
        return _colmap_binary(path)
    if path.name == "images.txt":
        return _colmap_text(path)
    return _nerfstudio(path) if path.suffix == ".json" else None


def by_time(poses: NamedPoses, stamps_s: Floats, names: Sequence[str] = ()) -> Trajectory:
    """The poses at the (n,) stamps of the frames of their images.

    An image belongs to the frame whose image has the same name (`names` (n,), without folders), else to the frame
    whose number (as in exports) or stamp is its name; one rule holds for all. Raises InputError if none fits.
    """
    stems = [PurePosixPath(name).stem for name in poses.names]
    own = {name: k for k, name in enumerate(names)}
    rules: list[list[int | None]] = [
        [own.get(PurePosixPath(name).name) for name in poses.names],
        [int(stem) if stem.isascii() and stem.isdigit() and len(stem) < 10 else None for stem in stems],
        [_at(stem, stamps_s) for stem in stems],
    ]
    for rule in rules:
        found = {k: row for row, k in enumerate(rule) if k is not None and k < len(stamps_s)}
        if len(found) >= max(LEAST, 0.5 * len(stems)):
            rows = se3.to_rows(poses.T_world_cam)
            left = len(stems) - len(found)
            words = f"{poses.source}{f', {left} images that are of no frame left out' if left else ''}"
            trajectory = from_rows({float(stamps_s[k]): tuple(rows[row]) for k, row in found.items()})
            return Trajectory(trajectory.timestamps_s, trajectory.T_world_cam, words)
    raise InputError(
        f"{poses.source}: its images ({shown(', '.join(poses.names[:2]))} ...) are named neither as the recording's "
        "images, nor by the number or the time stamp of a frame"
    )


def _at(stem: str, stamps_s: Floats) -> int | None:
    try:
        stamp = float(stem)
    except ValueError:
        return None
    if not len(stamps_s) or not np.isfinite(stamp):
        return None
    k = int(nearest(stamps_s, np.array([stamp]))[0])
    return k if abs(stamps_s[k] - stamp) <= SAME_STAMP_S else None


def _of_colmap(path: Path, names: list[str], rows: list[tuple[float, ...]]) -> NamedPoses:
    """`rows`: qw qx qy qz tx ty tz."""
    values = np.array(rows, float).reshape(-1, 7)
    length = np.linalg.norm(values[:, :4], axis=1)
    if not np.isfinite(values).all() or (np.abs(length - 1) > 0.02).any():
        raise InputError(f"{shown(path)}: a pose is not a rotation and a translation")
    T_cam_world = se3.pose(se3.rotations(values[:, :4], w_first=True), values[:, 4:])
    return NamedPoses(tuple(names), se3.inverse(T_cam_world), f"COLMAP model {shown(path)}")


def _colmap_text(path: Path) -> NamedPoses:
    names, rows = [], []
    text = path.read_text(encoding="utf-8", errors="replace")
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if not line.startswith("#")]
    for number, line in lines[::2]:  # between them, the points of each image
        parts = line.split(maxsplit=9)
        try:
            rows.append(tuple(float(part) for part in parts[1:8]))
            names.append(parts[9])
        except (ValueError, IndexError):
            raise InputError(f"{shown(path)}:{number}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME") from None
    return _of_colmap(path, names, rows)


def _colmap_binary(path: Path) -> NamedPoses:
    data, names, rows = path.read_bytes(), [], []
    try:
        (count,) = struct.unpack_from("<Q", data)
        at = 8
        for _ in range(count):
            _, *row, _ = HEAD.unpack_from(data, at)
            end = data.index(b"\0", at + HEAD.size)
            names.append(data[at + HEAD.size : end].decode("utf-8", "replace"))
            rows.append(tuple(row))
            (points,) = struct.unpack_from("<Q", data, end + 1)
            at = end + 9 + POINT_BYTES * points
        if at != len(data):
            raise ValueError(f"{len(data) - at} bytes after the last image")
    except (struct.error, ValueError, OverflowError) as error:
        raise InputError(f"{shown(path)}: damaged ({error})") from error
    return _of_colmap(path, names, rows)


def _nerfstudio(path: Path) -> NamedPoses:
    frames = read_json(path).get("frames")
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise InputError(f"{shown(path)}: no list of frames")
    names, T = [], []
    for k, frame in enumerate(frames):
        where = f"{shown(path)}: frame {k}: transform_matrix"
        T.append(usable_pose(numbers(frame.get("transform_matrix"), 16, where).reshape(4, 4) @ OPENGL_AXES, where))
        names.append(str(frame.get("file_path", "")))
    return NamedPoses(tuple(names), np.array(T).reshape(-1, 4, 4), f"transforms.json {shown(path)}")
