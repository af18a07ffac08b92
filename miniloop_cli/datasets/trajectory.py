"""Trajectories in TUM's text format: `timestamp tx ty tz qx qy qz qw` a line, camera to world."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.association import parse_stamp
from miniloop_cli.datasets.paths import read_lines, shown
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.sequence import Trajectory

HEADER = "# timestamp tx ty tz qx qy qz qw (s, m, camera to world)"
MAX_COORDINATE_M = 1e7


def from_rows(rows: dict[float, tuple[float, ...]]) -> Trajectory:
    """Stamps (s) with their (tx, ty, tz, qx, qy, qz, qw), in any order, quaternions of any length but 0."""
    stamps = np.array(sorted(rows), float)
    values = np.array([rows[t] for t in stamps], float).reshape(-1, 7)
    return Trajectory(stamps, se3.from_rows(values))


def read_trajectory(path: Path | str) -> Trajectory:
    """A trajectory or ground truth file; sorted by time, the first of equal stamps kept, quaternions normalised.

    Raises InputError naming file and line for anything that is not eight finite numbers with a usable quaternion,
    and for a file without poses.
    """
    path = Path(path)
    rows: dict[float, tuple[float, ...]] = {}
    name = shown(path)
    for number, line in read_lines(path):
        where = f"{name}:{number}"
        parts = line.replace(",", " ").split()
        if len(parts) < 8:
            raise InputError(f"{where}: expected 'timestamp tx ty tz qx qy qz qw', found {len(parts)} values")
        stamp = parse_stamp(parts[0], where)
        try:
            values = tuple(float(text) for text in parts[1:8])
        except ValueError:
            raise InputError(f"{where}: not a number in '{shown(line[:80])}'") from None
        if not all(math.isfinite(v) for v in values):
            raise InputError(f"{where}: NaN or infinity in the pose; remove the row")
        if max(map(abs, values)) > MAX_COORDINATE_M:
            raise InputError(f"{where}: a value beyond {MAX_COORDINATE_M:.0e}; positions are in metres")
        if math.hypot(*values[3:]) < 1e-6:
            raise InputError(f"{where}: the quaternion is zero; remove the row")
        rows.setdefault(stamp, values)
    if not rows:
        raise InputError(f"{name} has no poses; expected lines 'timestamp tx ty tz qx qy qz qw'")
    return from_rows(rows)


def write_trajectory(path: Path | str, trajectory: Trajectory) -> None:
    """Write TUM's format, stamps to the microsecond, whole or not at all."""
    T = trajectory.T_world_cam.reshape(-1, 4, 4)
    with atomic_write(Path(path)) as file:
        file.write(HEADER + "\n")
        for stamp, row in zip(trajectory.timestamps_s, se3.to_rows(T), strict=True):
            file.write(f"{stamp:.6f} " + " ".join(f"{v:.9f}" for v in row) + "\n")
