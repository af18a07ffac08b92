"""Polycam's raw data: keyframes/images, /depth (millimetres, lower resolution), /cameras (JSON, with ARKit's pose).

After loop closure, the app also writes corrected_images, without the distortion of the lens, and corrected_cameras
(github.com/PolyCam/polyform, README.md).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.beside import confidence_maps
from miniloop_cli.datasets.confidence import with_confidence
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import (
    given_camera,
    numbers,
    read_json,
    trajectory_of,
    usable_pose,
)
from miniloop_cli.datasets.own_cameras import with_own_cameras
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import DEPTH_SUFFIXES, IMAGE_SUFFIXES, shown
from miniloop_cli.datasets.stamps import MICROSECONDS
from miniloop_cli.datasets.stream import named_stream, seconds_of, stamped_files
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.conventions import OPENGL_AXES
from miniloop_cli.scene.sequence import DepthFormat, Note, NoteKind, Sequence, Trajectory

RECORDED = ("keyframes/images", "keyframes/cameras")
CORRECTED = ("keyframes/corrected_images", "keyframes/corrected_cameras")
PINHOLE = ("fx", "fy", "cx", "cy", "width", "height")
SAID = (
    "keyframes/corrected_images and corrected_cameras are used, undistorted and with the app's own loop closure; "
    "keyframes/images are not. Depth is that of the images as recorded: at the edges they differ by the distortion"
)


class Polycam:
    """Polycam raw data: keyframes/images, keyframes/depth (16-bit PNG, millimetres), keyframes/cameras."""

    def matches(self, root: Path) -> bool:
        """By the names of its folders."""
        return (root / "keyframes/depth").is_dir() and any((root / name[0]).is_dir() for name in (RECORDED, CORRECTED))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`, of the corrected images if they exist. Raises InputError.

        The phone refocuses, so every frame has its own intrinsics, and is resampled to the median camera.
        """
        images, folder = _used(root)
        color = named_stream(root, images, IMAGE_SUFFIXES, MICROSECONDS)
        depth = named_stream(root, "keyframes/depth", DEPTH_SUFFIXES, MICROSECONDS)
        found = pair(root, color, depth)
        frames, notes = found.frames, found.notes
        if images == CORRECTED[0]:
            notes = (*notes, Note(NoteKind.ASSUMED, SAID))
        camera = given_camera(root, camera_path, frames)
        if camera is None:
            files = stamped_files(root, folder, (".json",), MICROSECONDS)
            values = {stamp: _values(path, PINHOLE) for stamp, path in files.items()}
            middle = np.median(list(values.values()), axis=0).tolist()
            median = dict(zip(PINHOLE, middle, strict=True)) | {"depth_scale": 1000.0}
            source = f"median of the {len(values)} cameras in {folder}"
            camera = make_camera(median, shown(root / folder), source)
            stamps = seconds_of(color.numbers, color.times, color.unit).tolist()
            own = {s: values[t][:4] for s, t in zip(color.sources, stamps, strict=True) if t in values}
            frames, said = with_own_cameras(frames, own, camera)
            notes = (*notes, *said)
        maps, where, beside = confidence_maps(root, depth, "keyframes", MICROSECONDS)
        frames, trusted = with_confidence(frames, maps, where)
        truth = root / folder
        given, notes = truth if truth.is_dir() else None, (*notes, *trusted, *beside)
        return Sequence(root.name, root, camera, frames, given, notes, found.available, DepthFormat(resample=True))

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """ARKit's or the corrected poses t_00 ... t_23 (OpenGL camera axes), camera to world: not the truth."""
        if sequence.ground_truth_path is None:
            return None
        folder = f"keyframes/{sequence.ground_truth_path.name}"
        keys = tuple(f"t_{row}{column}" for row in range(3) for column in range(4))
        poses = {}
        for stamp, path in stamped_files(sequence.root, folder, (".json",), MICROSECONDS).items():
            T = np.vstack([_values(path, keys).reshape(3, 4), [0, 0, 0, 1]])
            poses[stamp] = usable_pose(T @ OPENGL_AXES, shown(path))
        return trajectory_of(poses, shown(sequence.ground_truth_path))


def _used(root: Path) -> tuple[str, str]:
    """The folders of colour images and of their cameras."""
    return CORRECTED if all((root / name).is_dir() for name in CORRECTED) else RECORDED


def _values(path: Path, keys: tuple[str, ...]) -> np.ndarray:
    data: dict[str, Any] = read_json(path)
    if missing := [key for key in keys if key not in data]:
        raise InputError(f"{shown(path)}: {missing[0]} missing")
    return numbers([data[key] for key in keys], len(keys), shown(path))
