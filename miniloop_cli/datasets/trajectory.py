"""Trajectories: read from the formats of many tools, written in TUM's (`timestamp tx ty tz qx qy qz qw` a line)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.datasets.trajectory_formats import read_pose_file
from miniloop_cli.datasets.trajectory_stamps import Numbered, to_trajectory
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Floats

HEADER = "# timestamp tx ty tz qx qy qz qw (s, m, camera to world)"


def from_rows(rows: dict[float, tuple[float, ...]]) -> Trajectory:
    """Stamps (s) with their (tx, ty, tz, qx, qy, qz, qw), in any order, quaternions of any length but 0."""
    stamps = np.array(sorted(rows), float)
    values = np.array([rows[t] for t in stamps], float).reshape(-1, 7)
    return Trajectory(stamps, se3.from_rows(values))


def read_trajectory(path: Path | str, frames_s: Floats | None = None, numbered: Numbered = dict) -> Trajectory:
    """The poses of a trajectory or ground truth file, sorted by time; `source` describes how the file was read.

    `frames_s`: (m,) sorted stamps of the frames of the poses, which determine the unit of the file's stamps;
    `numbered`: gives the stamps of the frames by number, for formats without stamps.
    Raises InputError naming file and line for malformed and for ambiguous content.
    """
    return to_trajectory(read_pose_file(path if isinstance(path, Path) else Path(path)), frames_s, numbered)


def write_trajectory(path: Path | str, trajectory: Trajectory) -> None:
    """Write TUM's format, with stamps to the microsecond, completely or not at all."""
    T = trajectory.T_world_cam.reshape(-1, 4, 4)
    with atomic_write(Path(path)) as file:
        file.write(HEADER + "\n")
        for stamp, row in zip(trajectory.timestamps_s, se3.to_rows(T), strict=True):
            file.write(f"{stamp:.6f} " + " ".join(f"{v:.9f}" for v in row) + "\n")
