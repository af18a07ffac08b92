"""ICL-NUIM's TUM-compatible PNGs: rgb/N.png, depth/N.png (5000 units a metre), *.gt.freiburg."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.datasets.numbered import given_camera
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.paths import DEPTH_SUFFIXES, IMAGE_SUFFIXES
from miniloop_cli.datasets.stream import RATE_HZ, named_stream
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.sequence import Sequence, Trajectory

SOURCE = "ICL-NUIM's published camera (481.2 480 319.5 239.5; fy positive, as image y points down)"
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


class IclNuim:
    """ICL-NUIM (TUM-compatible): rgb/N.png, depth/N.png, *.gt.freiburg."""

    def matches(self, root: Path) -> bool:
        """By the names of its files and folders."""
        return (root / "rgb").is_dir() and (root / "depth").is_dir() and any(root.glob("*.gt.freiburg"))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`, paired by frame number. Raises InputError."""
        found = pair(root, named_stream(root, "rgb", IMAGE_SUFFIXES), named_stream(root, "depth", DEPTH_SUFFIXES))
        camera = given_camera(root, camera_path, found.frames, 5000.0) or Camera(
            481.2, 480.0, 319.5, 239.5, 640, 480, 5000.0, source=SOURCE
        )
        truth = next(iter(sorted(root.glob("*.gt.freiburg"))), None)
        return Sequence(root.name, root, camera, found.frames, truth, found.notes, found.available)

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The published poses, mirrored: F T F with F = diag(1, -1, 1, 1).

        They belong to a renderer whose y points up (hence the published fy = -480). Its camera and its world are mirror
        images of those of a camera whose y points down. The stamps of the file are frame numbers.
        """
        if sequence.ground_truth_path is None:
            return None
        published = read_trajectory(sequence.ground_truth_path)
        return Trajectory(published.timestamps_s / RATE_HZ, MIRROR @ published.T_world_cam @ MIRROR)
