"""OpenLORIS-Scene: color/, aligned_depth/ with tables color.txt and aligned_depth.txt, and sensors.yaml.

sensors.yaml (OpenCV's FileStorage) has the colour camera as d400_color_optical_frame, its intrinsics in the order fx
cx fy cy; depth is millimetres, aligned to colour. groundtruth.txt holds poses of base_link, the robot's base;
trans_matrix.yaml has the transformation from the colour camera to it
(github.com/lifelong-robotic-vision/openloris-scene-tools, dataprocess/segway_transforms.py and
benchmark/openloris_tf_data.py, and loaders of others that read both files).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.camera_files.text import parse_mapping, read_text
from miniloop_cli.datasets.find_frames import find_frames
from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import given_camera, numbers, usable_pose
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import Note, NoteKind, Sequence, Trajectory
from miniloop_cli.typing import Floats

COLOR, DEPTH = "color", "aligned_depth"
SENSORS, TRANSFORMS, POSES = "sensors.yaml", "trans_matrix.yaml", "groundtruth.txt"
CAMERA, BASE = "d400_color_optical_frame", "base_link"
LENS = ("k1", "k2", "p1", "p2", "k3")


class OpenLoris:
    """OpenLORIS-Scene: color/, aligned_depth/ (16-bit PNG, millimetres), color.txt, aligned_depth.txt, sensors.yaml."""

    def matches(self, root: Path) -> bool:
        """By the names of its files and folders."""
        return (root / DEPTH).is_dir() and (root / COLOR).is_dir() and (root / SENSORS).is_file()

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`, of the colour camera and the depth aligned to it. Raises InputError."""
        found = find_frames(root, COLOR, DEPTH)
        notes = found.notes
        camera = given_camera(root, camera_path, found.frames) or _camera(root / SENSORS)
        truth = root / POSES if (root / POSES).is_file() else None
        if truth and not (root / TRANSFORMS).is_file():
            text = (
                f"{POSES} holds poses of the robot's base, and without {TRANSFORMS} those of the camera are not known"
            )
            notes, truth = (*notes, Note(NoteKind.UNUSED, text)), None
        return Sequence(
            root.name, root, camera, found.frames, truth, notes, found.available, color_only=found.color_only
        )

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The poses of the colour camera, from those of the robot's base."""
        if sequence.ground_truth_path is None:
            return None
        stamps = np.array([frame.timestamp_s for frame in sequence.frames])
        base = read_trajectory(sequence.ground_truth_path, stamps, lambda: {"frames of the recording": stamps})
        T_base_cam = _base_to_camera(sequence.root / TRANSFORMS)
        source = f"{base.source}, of {BASE}, moved to the colour camera by {TRANSFORMS}"
        return Trajectory(base.timestamps_s, base.T_world_cam @ T_base_cam, source)


def _camera(path: Path) -> Camera:
    where, data = shown(path), _mapping(path)
    sensor = data.get(CAMERA)
    if not isinstance(sensor, dict):
        raise InputError(f"{where}: no {CAMERA}; give the camera with --camera")
    where = f"{where}: {CAMERA}"
    fx, cx, fy, cy = numbers(_data(sensor.get("intrinsics")), 4, f"{where}: intrinsics").tolist()
    width, height = numbers([sensor.get("width"), sensor.get("height")], 2, f"{where}: width, height").tolist()
    values: dict[str, Any] = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": width, "height": height}
    model, k = sensor.get("distortion_model", "none"), _data(sensor.get("distortion_coefficients"))
    if isinstance(k, list) and any(k):
        if model != "radial-tangential" or len(k) not in (4, 5):
            raise InputError(f"{where}: a lens '{shown(str(model)[:40])}' with {len(k)} coefficients is not supported")
        values |= dict(zip(LENS, numbers(k, len(k), f"{where}: distortion_coefficients").tolist(), strict=False))
    return make_camera(values | {"depth_scale": 1000.0}, where, f"{CAMERA} of the sequence's own {path.name}")


def _base_to_camera(path: Path) -> Floats:
    """The pose of the colour camera in the robot's base."""
    where, rows = shown(path), _mapping(path).get("trans_matrix")
    for row in rows if isinstance(rows, list) else []:
        if isinstance(row, dict) and (row.get("parent_frame"), row.get("child_frame")) == (BASE, CAMERA):
            T = usable_pose(numbers(_data(row.get("matrix")), 16, f"{where}: matrix").reshape(4, 4), where)
            if T is not None:
                return T
    raise InputError(f"{where}: no transformation from {CAMERA} to {BASE}")


def _mapping(path: Path) -> dict[Any, Any]:
    data = parse_mapping(read_text(path), path)
    if not isinstance(data, dict):
        raise InputError(f"{shown(path)}: expected names of sensors")
    return data


def _data(matrix: Any) -> Any:
    return matrix.get("data") if isinstance(matrix, dict) else matrix
