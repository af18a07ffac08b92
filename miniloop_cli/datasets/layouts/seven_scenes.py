"""Microsoft's 7-Scenes: frame-000000.color.png, .depth.png (millimetres, 65535 = none) and .pose.txt in one folder."""

from __future__ import annotations

from pathlib import Path

from miniloop_cli.datasets.numbered import (
    RATE_HZ,
    frame_number,
    given_camera,
    numbered_images,
    pair_by_number,
    read_matrix,
    trajectory_of,
    usable_pose,
)
from miniloop_cli.datasets.paths import list_images, shown
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import DepthFormat, Sequence, Trajectory

SOURCE = "7-Scenes' default (585 585 320 240)"
UNREGISTERED = "7-Scenes' depth is not registered to colour; expect errors of some centimetres"


class SevenScenes:
    """7-Scenes: frame-NNNNNN.color.png, .depth.png (millimetres, 65535 = no reading), .pose.txt."""

    def matches(self, root: Path) -> bool:
        """By the names of its files."""
        return any(root.glob("frame-*.color.*"))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`. Raises InputError."""
        color = numbered_images(root, ".", (".color.png", ".color.jpg"))
        frames, notes, available = pair_by_number(root, color, numbered_images(root, ".", (".depth.png",)))
        camera = given_camera(root, camera_path, frames) or Camera(
            585.0, 585.0, 320.0, 240.0, 640, 480, 1000.0, source=SOURCE
        )
        truth = root if any(root.glob("frame-*.pose.txt")) else None
        depth_format = DepthFormat(no_reading=65535)
        notes = (*notes, UNREGISTERED)
        return Sequence(root.name, root, camera, frames, truth, notes, available, depth_format)

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The poses of the .pose.txt files, camera to world; frames whose pose is not finite are left out."""
        if sequence.ground_truth_path is None:
            return None
        poses = {}
        for path in list_images(sequence.root, ".", (".pose.txt",)):
            number = frame_number(path.name)
            if number is not None:
                poses[number / RATE_HZ] = usable_pose(read_matrix(path, (4, 4)), shown(path))
        return trajectory_of(poses, shown(sequence.root))
