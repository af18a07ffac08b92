"""Stray Scanner recordings: rgb.mp4, depth/ and confidence/ (lower resolution), odometry.csv, camera_matrix.csv.

One row of odometry.csv and one image of depth/ belong to each frame of the video, in order; the stamps of the video
only count frames. Newer versions of the app write the intrinsics of each frame into the same rows; camera_matrix.csv is
that of the last frame. Both are for the size of the video. Poses are camera to world, with axes x right, y down,
z forward of the sensor, independent of how the phone is held (github.com/strayrobots/scanner, docs/format.md and
StrayScanner/Helpers/*Encoder.swift).
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from miniloop_cli.datasets.beside import confidence_maps
from miniloop_cli.datasets.confidence import with_confidence
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import frame_number, given_camera, read_matrix, trajectory_of, usable_pose
from miniloop_cli.datasets.own_cameras import with_own_cameras
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import read_lines, shown
from miniloop_cli.datasets.stream import Stream, named_stream
from miniloop_cli.datasets.video_stream import timed_video
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import DepthFormat, Sequence, Trajectory
from miniloop_cli.typing import Floats

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
PINHOLE = ("fx", "fy", "cx", "cy")
VIDEO, POSES, MATRIX = "rgb.mp4", "odometry.csv", "camera_matrix.csv"


class StrayScanner:
    """Stray Scanner: rgb.mp4 (needs av), depth/ (16-bit PNG, millimetres), odometry.csv, camera_matrix.csv."""

    def matches(self, root: Path) -> bool:
        """By the names of its files and folders."""
        return (root / VIDEO).is_file() and (root / "depth").is_dir() and (root / MATRIX).is_file()

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`; the frames of the video are decoded when they are read. Raises InputError."""
        depth = named_stream(root, "depth", (".png",))
        if depth.numbers is None:
            raise InputError(f"{shown(root / 'depth')}: its images are not numbered, as those of Stray Scanner are")
        rows = _odometry(root / POSES) if (root / POSES).is_file() else []
        times_s = {row.number: row.time_s for row in rows if row.time_s is not None}
        color, said = timed_video(root / VIDEO, depth.numbers, times_s, POSES)
        maps, where, beside = confidence_maps(root, depth)
        found = pair(root, color, depth)
        camera = given_camera(root, camera_path, found.frames)
        frames, notes = found.frames, (*found.notes, *said)
        if camera is None:
            camera, own = _camera(root / MATRIX, rows, color)
            frames, moved = with_own_cameras(frames, own, camera)
            notes = (*notes, *moved)
        frames, trusted = with_confidence(frames, maps, where)
        notes = (*notes, *trusted, *beside)
        truth = root / POSES if rows else None
        return Sequence(root.name, root, camera, frames, truth, notes, found.available, DepthFormat(resample=True))

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """ARKit's poses: a reference, not the truth."""
        path = sequence.ground_truth_path
        if path is None:
            return None
        stamps = {frame_number(Path(frame.depth.name).name): frame.timestamp_s for frame in sequence.frames}
        poses = {row.time_s if row.time_s is not None else stamps.get(row.number): row.T for row in _odometry(path)}
        return trajectory_of({stamp: T for stamp, T in poses.items() if stamp is not None}, shown(path))


class _Row(NamedTuple):
    """A row of odometry.csv: its frame number, time (s), pose camera to world, and (fx fy cx cy); None: not there."""

    number: int
    time_s: float | None
    T: Floats | None
    pinhole: Floats | None


def _odometry(path: Path) -> list[_Row]:
    """The rows, by the header, which early versions of the app do not write. Raises InputError."""
    rows: list[_Row] = []
    names: tuple[str, ...] = POSE
    for line_number, line in read_lines(path):
        cells, where = [cell.strip() for cell in line.split(",")], f"{shown(path)}:{line_number}"
        if not rows and cells[0].lower() == "timestamp":
            names = tuple(cell.lower() for cell in cells)
            if missing := [name for name in ("frame", *POSE) if name not in names]:
                raise InputError(f"{where}: no column {missing[0]}")
            continue
        if len(cells) != len(names):
            raise InputError(f"{where}: {len(cells)} columns, expected {', '.join(names)}")
        found = dict(zip(names, cells, strict=True))
        try:
            pose = np.array([float(found[name]) for name in POSE])
            number, time_s = int(found.get("frame", len(rows))), float(found["timestamp"]) if len(names) > 7 else None
            given = all(found.get(name) for name in PINHOLE)
            pinhole = np.array([float(found[name]) for name in PINHOLE]) if given else None
        except ValueError:
            raise InputError(f"{where}: expected numbers, found '{shown(line[:60])}'") from None
        if not 0 <= number < 1 << 31 or (time_s is not None and not abs(time_s) < 1e12):
            raise InputError(f"{where}: expected a time in seconds and the number of a frame")
        usable = bool(np.isfinite(pose).all() and np.linalg.norm(pose[3:]) > 1e-6)
        T = usable_pose(se3.pose(se3.rotations(pose[3:]), pose[:3]), where) if usable else None
        rows.append(_Row(number, time_s, T, pinhole))
    return rows


def _camera(path: Path, rows: list[_Row], color: Stream) -> tuple[Camera, dict[ImageSource, Floats]]:
    """The common camera, and each frame's own: from the rows if these have them, else from camera_matrix.csv."""
    pinholes = {row.number: row.pinhole for row in rows if row.pinhole is not None}
    size = color.sources[0].header()
    if pinholes:
        middle, source = np.median(list(pinholes.values()), axis=0), f"median of the cameras of the sequence's {POSES}"
    else:
        K = read_matrix(path, (3, 3))
        middle, source = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]]), f"the sequence's own {path.name}, one for all"
    values = dict(zip((*PINHOLE, "width", "height"), (*middle.tolist(), size.width, size.height), strict=True))
    camera = make_camera(values | {"depth_scale": 1000.0}, shown(path), source)
    numbers = [] if color.numbers is None else color.numbers.tolist()
    pairs = zip(numbers, color.sources, strict=True)
    return camera, {image: own for number, image in pairs if (own := pinholes.get(number)) is not None}
