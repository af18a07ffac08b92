"""Microsoft's 7-Scenes: frame-000000.color.png, .depth.png (millimetres, 65535 = none) and .pose.txt in one folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.numbered import (
    given_camera,
    poses_in_files,
)
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.stream import named_stream
from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.geometry.lens import PINHOLE
from miniloop_cli.scene.sequence import DepthCamera, DepthFormat, Note, NoteKind, Sequence, Trajectory

SOURCE = "7-Scenes' default (585 585 320 240)"
UNREGISTERED = "7-Scenes' depth is not registered to colour, and both cameras are guesses (docs/calibration.md)"


class SevenScenes:
    """7-Scenes: frame-NNNNNN.color.png, .depth.png (millimetres, 65535 = no reading), .pose.txt."""

    def matches(self, root: Path) -> bool:
        """By the names of its files."""
        return any(root.glob("frame-*.color.*"))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`. Raises InputError."""
        color = named_stream(root, ".", (".color.png", ".color.jpg"))
        found = pair(root, color, named_stream(root, ".", (".depth.png",)))
        default = Camera(585.0, 585.0, 320.0, 240.0, 640, 480, 1000.0, source=SOURCE, trust=Trust.GUESS)
        camera = given_camera(root, camera_path, found.frames) or default
        # The depth camera is assumed at the pose of the colour camera until it is estimated.
        own = DepthCamera(replace(camera, lens=PINHOLE, trust=Trust.GUESS), tuple(np.eye(4).ravel().tolist()))
        truth = root if any(root.glob("frame-*.pose.txt")) else None
        notes = (*found.notes, Note(NoteKind.ASSUMED, UNREGISTERED))
        form = DepthFormat(no_reading=(65535,))
        return Sequence(root.name, root, camera, found.frames, truth, notes, found.available, form, depth_camera=own)

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The poses of the .pose.txt files, camera to world; frames whose pose is not finite are left out."""
        if sequence.ground_truth_path is None:
            return None
        return poses_in_files(sequence.root, ".", ".pose.txt")
