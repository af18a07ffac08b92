"""Polycam's raw data: keyframes/images, /depth (millimetres, lower resolution), /cameras (JSON, with ARKit's pose)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import (
    given_camera,
    numbered_files,
    numbered_images,
    numbers,
    pair_by_number,
    read_json,
    trajectory_of,
    usable_pose,
)
from miniloop_cli.datasets.paths import shown
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.conventions import OPENGL_AXES
from miniloop_cli.scene.sequence import DepthFormat, Sequence, Trajectory

STAMPS_HZ = 1e6  # files are named by microseconds
PINHOLE = ("fx", "fy", "cx", "cy", "width", "height")
ZOOM_TOLERANCE = 0.01


class Polycam:
    """Polycam raw data: keyframes/images, keyframes/depth (16-bit PNG, millimetres), keyframes/cameras."""

    def matches(self, root: Path) -> bool:
        """By the names of its folders."""
        return (root / "keyframes" / "depth").is_dir() and (root / "keyframes" / "images").is_dir()

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`; the images as recorded, since the depth belongs to those. Raises InputError.

        The phone refocuses, so every frame has its own intrinsics; their median is used, and a note says how far the
        focal length strays.
        """
        color = numbered_images(root, "keyframes/images", rate_hz=STAMPS_HZ)
        frames, notes, available = pair_by_number(
            root, color, numbered_images(root, "keyframes/depth", rate_hz=STAMPS_HZ), STAMPS_HZ
        )
        camera = given_camera(root, camera_path, frames)
        if camera is None:
            files = numbered_files(root, "keyframes/cameras", (".json",), STAMPS_HZ)
            values = np.array([_values(path, PINHOLE) for path in files.values()])
            if not len(values):
                raise InputError(f"{shown(root)}: no camera in keyframes/cameras; give --camera FILE")
            median = dict(zip(PINHOLE, np.median(values, axis=0).tolist(), strict=True)) | {"depth_scale": 1000.0}
            source = f"median of the {len(values)} cameras in keyframes/cameras"
            camera = make_camera(median, shown(root / "keyframes/cameras"), source)
            stray = np.abs(values[:, 0] / camera.fx - 1).max()
            if stray > ZOOM_TOLERANCE:
                notes = (*notes, f"the focal length strays by up to {100 * stray:.1f} % from its median, which is used")
        truth = root / "keyframes" / "cameras"
        given = truth if truth.is_dir() else None
        return Sequence(root.name, root, camera, frames, given, notes, available, DepthFormat(resample=True))

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """ARKit's poses t_00 ... t_23 (OpenGL camera axes), camera to world: a reference, not the truth."""
        if sequence.ground_truth_path is None:
            return None
        keys = tuple(f"t_{row}{column}" for row in range(3) for column in range(4))
        poses = {}
        for number, path in numbered_files(sequence.root, "keyframes/cameras", (".json",), STAMPS_HZ).items():
            T = np.vstack([_values(path, keys).reshape(3, 4), [0, 0, 0, 1]])
            poses[number / STAMPS_HZ] = usable_pose(T @ OPENGL_AXES, shown(path))
        return trajectory_of(poses, shown(sequence.ground_truth_path))


def _values(path: Path, keys: tuple[str, ...]) -> np.ndarray:
    data: dict[str, Any] = read_json(path)
    if missing := [key for key in keys if key not in data]:
        raise InputError(f"{shown(path)}: {missing[0]} missing")
    return numbers([data[key] for key in keys], len(keys), shown(path))
