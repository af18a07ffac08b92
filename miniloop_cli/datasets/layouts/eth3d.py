"""ETH3D's SLAM benchmark: TUM's tables and folders, and calibration.txt (fx fy cx cy).

Depth is stored at 5000 units a metre, as TUM's (github.com/ETH3D/badslam, README.md), and re-projected into the colour
camera; the calibration has no lens. Poses are camera to world (www.eth3d.net/slam_documentation).
"""

from __future__ import annotations

from pathlib import Path

from miniloop_cli.datasets.find_frames import find_frames
from miniloop_cli.datasets.intrinsics import freiburg_family, make_camera
from miniloop_cli.datasets.layouts.tum import Tum
from miniloop_cli.datasets.numbered import color_size, given_camera, read_matrix
from miniloop_cli.datasets.paths import read_bytes, shown
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Sequence, Trajectory

CALIBRATION = "calibration.txt"
DEPTH_SCALE = 5000.0
MAX_BYTES = 4096


class Eth3d:
    """ETH3D SLAM: rgb/, depth/ (16-bit PNG, 5000 units a metre), rgb.txt, depth.txt, calibration.txt (fx fy cx cy)."""

    def matches(self, root: Path) -> bool:
        """By TUM's folders and a calibration.txt of four numbers, unless the folder's name is one of TUM's own."""
        path = root / CALIBRATION
        return path.is_file() and Tum().matches(root) and not freiburg_family(root.name) and _four_numbers(path)

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`. Raises InputError."""
        found = find_frames(root, "rgb", "depth")
        camera = given_camera(root, camera_path, found.frames, DEPTH_SCALE)
        if camera is None:
            size, path = color_size(found.frames), root / CALIBRATION
            if size is None:
                raise InputError(f"{shown(root)}: none of the first colour images can be read")
            values = dict(zip(("fx", "fy", "cx", "cy"), read_matrix(path, (1, 4))[0].tolist(), strict=True))
            values |= {"width": size[0], "height": size[1], "depth_scale": DEPTH_SCALE}
            camera = make_camera(values, shown(path), f"the sequence's own {CALIBRATION}")
        truth = root / "groundtruth.txt"
        given = truth if truth.is_file() else None
        return Sequence(
            root.name, root, camera, found.frames, given, found.notes, found.available, color_only=found.color_only
        )

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The motion capture trajectory, if there is one."""
        return Tum().ground_truth(sequence)


def _four_numbers(path: Path) -> bool:
    try:
        words = read_bytes(path, MAX_BYTES).split()
        return len([float(word) for word in words]) == 4
    except (InputError, ValueError):
        return False
