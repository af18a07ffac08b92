"""TUM RGB-D folders: rgb/, depth/, tables rgb.txt and depth.txt (or file names that are stamps), groundtruth.txt."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.datasets.beside import unused_cameras, unused_confidence
from miniloop_cli.datasets.find_frames import association_files, find_frames
from miniloop_cli.datasets.intrinsics import default_camera, freiburg_camera, freiburg_family
from miniloop_cli.datasets.numbered import given_camera
from miniloop_cli.datasets.paths import read_bytes
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import Frame, Sequence, Trajectory


class Tum:
    """TUM: rgb/ and depth/ (16-bit PNG, 5000 units a metre), with rgb.txt and depth.txt or stamps as names."""

    def matches(self, root: Path) -> bool:
        """By the names of its tables and folders."""
        named = all((root / f"{kind}.txt").exists() or (root / kind).is_dir() for kind in ("rgb", "depth"))
        return named or (bool(association_files(root)) and (root / "depth").is_dir())

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`; nothing is decoded.

        Raises InputError for malformed tables, for rows that point outside the folder, and if no colour image has a
        depth image within 20 ms.
        """
        found = find_frames(root, "rgb", "depth")
        truth = root / "groundtruth.txt"
        camera = choose_camera(root, camera_path, found.frames)
        beside = unused_confidence(root)
        if camera_path is None:
            used = "camera.yaml" if (root / "camera.yaml").exists() else ""
            beside += unused_cameras(root, used, guessed=camera == default_camera())
        return Sequence(
            root.name,
            root,
            camera,
            found.frames,
            ground_truth_path=truth if truth.exists() else None,
            notes=(*found.notes, *beside),
            available=found.available,
            color_only=found.color_only,
        )

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The motion capture trajectory, if there is one."""
        if sequence.ground_truth_path is None:
            return None
        stamps = np.array([frame.timestamp_s for frame in sequence.frames])
        return read_trajectory(sequence.ground_truth_path, stamps, lambda: {"frames of the recording": stamps})


def choose_camera(root: Path, camera_path: Path | None, frames: tuple[Frame, ...] = ()) -> Camera:
    """The given file, the sequence's own camera.yaml, its TUM family (header, then name), or TUM's default."""
    if camera := given_camera(root, camera_path, frames, depth_scale=5000.0):
        return camera
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        if (root / name).exists() and (family := freiburg_family(table_header(root / name))):
            return freiburg_camera(family, f"the header of {name}")
    if family := freiburg_family(root.name):
        return freiburg_camera(family, "the folder's name")
    return default_camera()


def table_header(path: Path) -> str:
    """The comments in the first lines of a table."""
    text = read_bytes(path).decode("utf-8", "replace")
    return "\n".join(line for line in text[:4096].split("\n") if line.startswith("#"))
