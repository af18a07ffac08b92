"""ScanNet scans as its SensReader exports them: color/, depth/ (millimetres), pose/ and intrinsic/."""

from __future__ import annotations

from pathlib import Path

from miniloop_cli.datasets.intrinsics import make_camera
from miniloop_cli.datasets.numbered import (
    color_size,
    given_camera,
    poses_in_files,
    read_matrix,
)
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import DEPTH_SUFFIXES, IMAGE_SUFFIXES, shown
from miniloop_cli.datasets.stream import named_stream
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import DepthFormat, Frame, Sequence, Trajectory

INTRINSICS = "intrinsic/intrinsic_color.txt"


class ScanNet:
    """ScanNet (exported): color/, depth/ (16-bit PNG, millimetres), pose/, intrinsic/intrinsic_color.txt."""

    def matches(self, root: Path) -> bool:
        """By the names of its folders."""
        return all((root / name).is_dir() for name in ("color", "depth", "pose"))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`; depth of lower resolution must cover the view of colour. Raises InputError."""
        found = pair(root, named_stream(root, "color", IMAGE_SUFFIXES), named_stream(root, "depth", DEPTH_SUFFIXES))
        camera = given_camera(root, camera_path, found.frames) or _camera(root, found.frames)
        truth = root / "pose" if (root / "pose").is_dir() else None
        form = DepthFormat(resample=True)
        return Sequence(root.name, root, camera, found.frames, truth, found.notes, found.available, form)

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The poses of pose/, camera to world; ScanNet marks frames where tracking was lost by infinity."""
        if sequence.ground_truth_path is None:
            return None
        return poses_in_files(sequence.root, "pose", ".txt")


def _camera(root: Path, frames: tuple[Frame, ...]) -> Camera:
    """Intrinsics of the colour camera; the size is that of the images, as no file of the export states it."""
    K, where = read_matrix(root / INTRINSICS, (4, 4)), shown(root / INTRINSICS)
    size = color_size(frames)
    if size is None:
        raise InputError(f"{shown(root)}: none of the first {len(frames[:20])} colour images can be read")
    values = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    values |= {"width": size[0], "height": size[1], "depth_scale": 1000.0}
    return make_camera({key: float(v) for key, v in values.items()}, where, f"the sequence's own {INTRINSICS}")
