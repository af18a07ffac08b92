"""Open3D's recorder and Redwood's scans: color/ (or image/) and depth/ in millimetres, intrinsics as JSON."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.beside import unused_cameras, unused_confidence
from miniloop_cli.datasets.camera_files import read_camera_file
from miniloop_cli.datasets.find_frames import find_frames
from miniloop_cli.datasets.numbered import (
    color_size,
    given_camera,
    trajectory_of,
    usable_pose,
)
from miniloop_cli.datasets.paths import IMAGE_SUFFIXES, read_lines, shown
from miniloop_cli.datasets.stream import stamped_files
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.scene.sequence import Frame, Sequence, Trajectory

COLOR = ("color", "colour", "image", "images", "cam0")
INTRINSICS = ("camera_intrinsic.json", "intrinsic.json", "intrinsics.json", "camera.json")
LOGS = ("trajectory.log", "odometry.log")


class Redwood:
    """Open3D, Redwood: color/ (or image/) and depth/ (16-bit PNG, millimetres), intrinsic.json, trajectory.log."""

    def matches(self, root: Path) -> bool:
        """By the names of its folders."""
        return (root / "depth").is_dir() and _first(root, COLOR) is not None and not (root / "pose").is_dir()

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`; images are paired by tables, times in names, or numbers. Raises InputError."""
        folder = _first(root, COLOR)
        if folder is None:
            raise InputError(f"{shown(root)}: no folder color/ or image/")
        found = find_frames(root, folder.name, "depth")
        camera, used = given_camera(root, camera_path, found.frames), "camera.yaml"
        if camera is None:
            camera, used = _camera(root, found.frames)
        beside = unused_confidence(root)
        if camera_path is None:
            beside += unused_cameras(root, used, guessed=not used)
        return Sequence(
            root.name,
            root,
            camera,
            found.frames,
            _first(root, LOGS),
            (*found.notes, *beside),
            found.available,
        )

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """Redwood's trajectory log: for each pose a line of three numbers and four rows of a matrix, camera to world.

        The first of the three numbers counts the images of the folder from 0 on. Raises InputError for malformed lines.
        """
        path, folder = sequence.ground_truth_path, _first(sequence.root, COLOR)
        if path is None or folder is None:
            return None
        stamps_s = list(stamped_files(sequence.root, folder.name, IMAGE_SUFFIXES))
        lines = read_lines(path)
        poses = {}
        for start in range(0, len(lines), 5):
            where = f"{shown(path)}:{lines[start][0]}"
            try:
                rows = [[float(text) for text in line.split()] for _, line in lines[start : start + 5]]
            except ValueError:
                raise InputError(f"{where}: not numbers") from None
            if [len(row) for row in rows] != [3, 4, 4, 4, 4] or not math.isfinite(rows[0][0]):
                raise InputError(f"{where}: expected a line of 3 numbers and 4 rows of 4")
            if 0 <= (k := int(rows[0][0])) < len(stamps_s):
                poses[stamps_s[k]] = usable_pose(np.array(rows[1:]), where)
        return trajectory_of(poses, shown(path))


def _first(root: Path, names: tuple[str, ...]) -> Path | None:
    return next((root / name for name in names if (root / name).exists()), None)


def _camera(root: Path, frames: tuple[Frame, ...]) -> tuple[Camera, str]:
    """The camera of the JSON file, else Open3D's default, and the name of the file."""
    path = _first(root, INTRINSICS)
    if path is None:
        source = (
            "Open3D's default for PrimeSense (525 525 319.5 239.5): no intrinsic.json; --camera FILE is more accurate"
        )
        camera = Camera(
            525.0, 525.0, 319.5, 239.5, 640, 480, 1000.0, source=source, depth_scale_assumed=True, trust=Trust.GUESS
        )
        return camera, ""
    return read_camera_file(path, f"the sequence's own {path.name}", color_size(frames), depth_scale=1000.0), path.name
