"""The Bonn RGB-D Dynamic data set: TUM's tables and folders, with a calibration of its own.

The camera and the convention of the poses are published with the data set
(www.ipb.uni-bonn.de/data/rgbd-dynamic-dataset): groundtruth.txt has the poses of the markers, in the axes of ROS, and
T_g = T_ros T T_ros T_m maps points of the colour camera to the laser scan. T_m has a scale of 1.059, which a pose
cannot have; only its rotation and translation are used.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.find_frames import find_frames
from miniloop_cli.datasets.layouts.tum import Tum, table_header
from miniloop_cli.datasets.numbered import given_camera
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import radial_tangential_lens
from miniloop_cli.scene.sequence import Sequence, Trajectory

NAME = re.compile(r"rgbd_bonn", re.IGNORECASE)
CAMERA = Camera(
    542.822841,
    542.576870,
    315.593520,
    237.756098,
    640,
    480,
    5000.0,
    radial_tangential_lens(0.039903, -0.099343, -0.000730, -0.000144, 0.0),
    source="the published calibration of the Bonn RGB-D Dynamic data set",
)
T_ROS = np.array([[-1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # its own inverse
T_M = np.array(
    [
        [1.0157, 0.1828, -0.2389, 0.0113],
        [0.0009, -0.8431, -0.6413, -0.0098],
        [-0.3009, 0.6147, -0.8085, 0.0111],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
T_MARKERS_CAM = se3.pose(se3.project_so3(T_M[:3, :3]), T_M[:3, 3])


class Bonn:
    """Bonn RGB-D Dynamic: rgb/, depth/ (16-bit PNG, 5000 units a metre), rgb.txt, depth.txt, named rgbd_bonn_..."""

    def matches(self, root: Path) -> bool:
        """By TUM's folders, and the name of the data set in that of the folder or in the header of a table."""
        return Tum().matches(root) and (bool(NAME.search(root.name)) or _named_in_tables(root))

    def open(self, root: Path, camera_path: Path | None) -> Sequence:
        """The sequence in `root`. Raises InputError."""
        found = find_frames(root, "rgb", "depth")
        camera = given_camera(root, camera_path, found.frames, CAMERA.depth_scale) or CAMERA
        truth = root / "groundtruth.txt"
        given = truth if truth.is_file() else None
        return Sequence(
            root.name, root, camera, found.frames, given, found.notes, found.available, color_only=found.color_only
        )

    def ground_truth(self, sequence: Sequence) -> Trajectory | None:
        """The poses of the colour camera, from those of the markers by the published transformation."""
        markers = Tum().ground_truth(sequence)
        if markers is None:
            return None
        T = T_ROS @ markers.T_world_cam @ T_ROS @ T_MARKERS_CAM
        source = f"{markers.source}, of markers, moved to the colour camera as the data set says"
        return Trajectory(markers.timestamps_s, T, source)


def _named_in_tables(root: Path) -> bool:
    paths = [root / name for name in ("rgb.txt", "depth.txt", "groundtruth.txt")]
    return any(NAME.search(table_header(path)) for path in paths if path.is_file())
