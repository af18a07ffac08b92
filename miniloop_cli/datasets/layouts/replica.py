"""Replica as NICE-SLAM renders it: results/frame000000.jpg, results/depth000000.png, traj.txt.

The camera and the unit of depth are in cam_params.json, which the data set has once, beside its scenes. A row of
traj.txt is a matrix camera to world, x right, y down, z forward (github.com/cvg/nice-slam, src/utils/datasets.py
turns it to OpenGL's axes, configs/Replica/replica.yaml has the camera).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.images import ImageFile
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import (
    frame_number,
    given_camera,
    numbers,
    pair_by_number,
    read_json,
    trajectory_of,
    usable_pose,
)
from miniloop_cli.datasets.paths import list_files, read_lines, shown
from miniloop_cli.datasets.stream import RATE_HZ
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import Sequence, Trajectory

PARAMETERS = "cam_params.json"
NICE_SLAM = Camera(600.0, 600.0, 599.5, 339.5, 1200, 680, 6553.5)
SOURCE = f"NICE-SLAM's of Replica (600 600 599.5 339.5, 6553.5 units a metre): there is no {PARAMETERS}"


class Replica:
    """Replica (NICE-SLAM): results/frame*.jpg, results/depth*.png (6553.5 units a metre), traj.txt, cam_params.json."""

    def matches(self, root: Path) -> bool:
        """By the names of its files."""
        results = root / "results"
        return results.is_dir() and any(results.glob("frame*.*")) and any(results.glob("depth*.png"))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`, paired by frame number. Raises InputError."""
        files, _ = list_files(root, "results", (".jpg", ".jpeg", ".png"))
        color = _numbered([path for path in files if path.name.startswith("frame")], root)
        depth = _numbered([path for path in files if path.name.startswith("depth")], root)
        frames, notes, available = pair_by_number(root, color, depth)
        camera = given_camera(root, camera_path, frames, NICE_SLAM.depth_scale) or _camera(root)
        truth = root / "traj.txt"
        return Sequence(root.name, root, camera, frames, truth if truth.is_file() else None, notes, available)

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The poses of the renderer: row n is that of frame n, from 0 on. Raises InputError for malformed rows."""
        path = sequence.ground_truth_path
        if path is None:
            return None
        poses = {}
        for k, (number, line) in enumerate(read_lines(path)):
            where = f"{shown(path)}:{number}"
            try:
                values = np.array([float(text) for text in line.split()])
            except ValueError:
                values = np.zeros(0)
            if len(values) != 16:
                raise InputError(f"{where}: expected the 16 numbers of a matrix")
            poses[k / RATE_HZ] = usable_pose(values.reshape(4, 4), where)
        return trajectory_of(poses, shown(path))


def _numbered(paths: list[Path], root: Path) -> dict[int, ImageSource]:
    found: dict[int, ImageSource] = {}
    for path in paths:
        number = frame_number(path.name)
        if number is not None and number in found:
            raise InputError(f"{shown(root)}: {shown(found[number].name)} and {shown(path)} have the same number")
        if number is not None:
            found[number] = ImageFile(path)
    return found


def _camera(root: Path) -> Camera:
    path = next((folder / PARAMETERS for folder in (root, root.parent) if (folder / PARAMETERS).is_file()), None)
    if path is None:
        values, where, source = NICE_SLAM, shown(root), SOURCE
        keys = ("fx", "fy", "cx", "cy", "width", "height", "depth_scale")
        camera = make_camera({key: getattr(values, key) for key in keys}, where, source)
        return replace(camera, depth_scale_assumed=True)
    where = f"{shown(path)}: camera"
    data = read_json(path).get("camera")
    if not isinstance(data, dict):
        raise InputError(f"{where} must be a group of w, h, fx, fy, cx, cy, scale")
    found = numbers([data.get(key) for key in ("fx", "fy", "cx", "cy", "w", "h", "scale")], 7, where)
    keys = ("fx", "fy", "cx", "cy", "width", "height", "depth_scale")
    return make_camera(dict(zip(keys, found.tolist(), strict=True)), where, f"the data set's own {PARAMETERS}")
