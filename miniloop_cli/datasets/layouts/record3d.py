"""Record3D exports: rgb/, depth/ (16-bit PNG, millimetres, lower resolution) and metadata.json with ARKit's poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import (
    RATE_HZ,
    given_camera,
    numbered_images,
    numbers,
    pair_by_number,
    read_json,
    trajectory_of,
    usable_pose,
)
from miniloop_cli.datasets.paths import list_images, shown
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.conventions import OPENGL_AXES
from miniloop_cli.scene.sequence import DepthFormat, Sequence, Trajectory

EXR = "its depth is EXR, which OpenCV's wheels do not read; convert depth/*.exr to 16-bit PNG in millimetres"


class Record3D:
    """Record3D: rgb/, depth/ (16-bit PNG, millimetres), metadata.json."""

    def matches(self, root: Path) -> bool:
        """By the names of its files and folders."""
        return all((root / name).exists() for name in ("rgb", "depth", "metadata.json"))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`. Raises InputError, also for depth in EXR or in the app's own compression."""
        depth = numbered_images(root, "depth", (".png",))
        if not depth and list_images(root, "depth", (".exr",)):
            raise InputError(f"{shown(root)}: {EXR}")
        frames, notes, available = pair_by_number(root, numbered_images(root, "rgb"), depth)
        camera = given_camera(root, camera_path, frames) or _camera(root)
        metadata = root / "metadata.json"
        truth = metadata if metadata.exists() else None
        return Sequence(root.name, root, camera, frames, truth, notes, available, DepthFormat(resample=True))

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """ARKit's poses (qx qy qz qw px py pz a frame, OpenGL camera axes): a reference, not the truth."""
        if sequence.ground_truth_path is None:
            return None
        where = shown(sequence.ground_truth_path)
        rows = read_json(sequence.ground_truth_path).get("poses")
        if not isinstance(rows, list) or not rows:
            return None
        values = numbers(rows, 7 * len(rows), f"{where}: poses").reshape(-1, 7)
        norms = np.linalg.norm(values[:, :4], axis=1)
        usable = np.isfinite(values).all(axis=1) & (norms > 1e-6)
        poses = {}
        for k in np.flatnonzero(usable).tolist():
            T_world_gl = se3.pose(se3.rotations(values[k, :4]), values[k, 4:])
            poses[k / RATE_HZ] = usable_pose(T_world_gl @ OPENGL_AXES, where)
        return trajectory_of(poses, where)


def _camera(root: Path) -> Camera:
    """`K` is stored by columns and belongs to the colour images of size `w` x `h`."""
    path = root / "metadata.json"
    data, where = read_json(path), shown(path)
    K = numbers(data.get("K"), 9, f"{where}: K")
    size = numbers([data.get("w"), data.get("h")], 2, f"{where}: w, h")
    keys = ("fx", "fy", "cx", "cy", "width", "height", "depth_scale")
    values = dict(zip(keys, [*K[[0, 4, 6, 7]].tolist(), *size.tolist(), 1000.0], strict=True))
    return make_camera(values, where, "the sequence's own metadata.json")
