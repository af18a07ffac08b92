"""A results folder, read back: what `register` wrote, for eval, export, mesh and report."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.pairs import read_pairs
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.landmarks import Landmarks
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Floats

RESULTS_ROOT = Path("results")
LARGEST = 1e12  # larger numbers are damage


def newest_result(root: Path = RESULTS_ROOT) -> Path:
    """The folder below `root` whose trajectory.txt was written last. Raises InputError if there is none."""
    found = sorted(root.glob("*/trajectory.txt"), key=lambda path: (path.stat().st_mtime_ns, path))
    if not found:
        raise InputError(f"no result under {root.resolve()}: run `miniloop register` first, or name a folder")
    return found[-1].parent


@dataclass(frozen=True)
class Results:
    """The folder of one run; files are read on first use, missing optional ones are empty."""

    root: Path

    @cached_property
    def trajectory(self) -> Trajectory:
        """trajectory.txt. Raises InputError if it is missing or malformed."""
        from miniloop_cli.datasets.trajectory import read_trajectory

        path = self.root / "trajectory.txt"
        if not path.is_file():
            raise InputError(f"{self.root} has no trajectory.txt: give the folder that `miniloop register` wrote")
        return read_trajectory(path)

    @cached_property
    def camera(self) -> Camera | None:
        """The camera of camera.yaml, None without the file. Raises InputError or ConfigError if it is damaged."""
        from miniloop_cli.datasets.camera_files import read_camera_file

        path = self.root / "camera.yaml"
        return read_camera_file(path) if path.is_file() else None

    def check_camera(self) -> None:
        """Raise InputError or ConfigError if a run's camera.yaml is damaged, for callers that do not read it."""
        if self.summary:  # else the folder and its camera.yaml may be of another program
            _ = self.camera

    @cached_property
    def edges(self) -> list[dict[str, str]]:
        """Rows of edges.csv."""
        return read_table(self.root / "edges.csv")

    @cached_property
    def frames(self) -> list[dict[str, str]]:
        """Rows of frames.csv."""
        return read_table(self.root / "frames.csv")

    @cached_property
    def summary(self) -> dict[str, Any]:
        """summary.json. Raises InputError if it is not a JSON object."""
        path = self.root / "summary.json"
        if not path.is_file():
            return {}
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}: not valid JSON ({error}); run `miniloop register` again") from error
        if not isinstance(data, dict):
            raise InputError(f"{path}: expected a JSON object; run `miniloop register` again")
        return data

    @property
    def leveled(self) -> bool:
        """Whether gravity turned the world of the result so that z is up."""
        return self.summary.get("leveled") is True

    @cached_property
    def frame_stamps_s(self) -> Floats:
        """(n,) time stamps of the recording's frames by number, from frames.csv; empty without it.

        Raises InputError if they are not increasing numbers.
        """
        path = self.root / "frames.csv"
        stamps = column(self.frames, "timestamp", path)
        if not (np.isfinite(stamps).all() and (np.diff(stamps) > 0).all()):
            raise InputError(f"{path}: column timestamp must hold increasing numbers")
        return stamps

    @cached_property
    def landmarks(self) -> Landmarks:
        """landmarks.npz, by frame numbers; none without the file. Raises InputError if it is damaged."""
        from miniloop_cli.results.landmarks import read_landmarks

        return read_landmarks(self.root / "landmarks.npz")

    @cached_property
    def edge_stamps_s(self) -> Floats:
        """(e, 2) time stamps of the two frames of every verified edge."""
        return edge_stamps(self.edges, self.root / "edges.csv")


def read_table(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file with a header, by column name; [] without the file. Raises InputError for a ragged row."""
    if not path.is_file():
        return []
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file, strict=True))
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a readable CSV file ({error})") from error
    for number, row in enumerate(rows, 2):
        if None in row or None in row.values():
            raise InputError(f"{path}, row {number}: the number of columns differs from the header's")
    return rows


def column(rows: Sequence[dict[str, str]], name: str, path: Path) -> Floats:
    """(n,) a column as numbers, NaN where it is missing, empty or too large. Raises InputError for other text."""
    try:
        values = np.array([float(row.get(name) or "nan") for row in rows], float)
    except ValueError as error:
        raise InputError(f"{path}: column {name}: {error}") from None
    return np.where(np.abs(values) < LARGEST, values, np.nan)


def edge_stamps(rows: list[dict[str, str]], path: Path) -> Floats:
    """(e, 2) time stamps (s) of the verified edges among rows of edges.csv; of all rows without verdicts.

    Raises InputError for rows without stamps.
    """
    stamps = np.stack([column(rows, f"timestamp_{end}", path) for end in "ij"], axis=1)
    verified = np.array([row.get("verdict", "verified") == "verified" for row in rows], bool)
    if np.isnan(stamps).any():
        raise InputError(f"{path}: every row needs timestamp_i and timestamp_j")
    return stamps[verified]


def read_edge_list(path: Path, frame_stamps_s: Floats) -> Floats:
    """(e, 2) time stamps of a plain list of edges (`scans.pairs`). Raises InputError for a malformed line."""
    pairs = read_pairs(path, len(frame_stamps_s))
    return frame_stamps_s[np.array(pairs, np.int64).reshape(-1, 2)]
