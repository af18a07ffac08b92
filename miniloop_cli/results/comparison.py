"""Two results side by side, or a result and the trajectory of another program."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.named_poses import by_time, read_named_poses
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import InputError, MiniloopError
from miniloop_cli.evaluation.evaluate import Evaluation, Protocol, evaluate
from miniloop_cli.geometry import se3
from miniloop_cli.results.columns import ReportData, load
from miniloop_cli.results.evaluation_inputs import ground_truth, run_of
from miniloop_cli.results.facts import runs
from miniloop_cli.runtime.safe_yaml import load_plain
from miniloop_cli.scene.interpolation import nearest
from miniloop_cli.scene.sequence import Sequence, Trajectory
from miniloop_cli.typing import Floats, Ints

FARTHEST_SHARE = 0.05  # of the poses: those that differ most
SCALE_OFF = 0.02  # a scale that differs by more is reported
Pair = tuple[int, int]


@dataclass(frozen=True)
class Side:
    """One of the two: its poses and, if it is a run, its tables."""

    name: str
    trajectory: Trajectory
    run: ReportData | None = None


@dataclass(frozen=True)
class Comparison:
    """`laid`: the second's poses aligned to the first, which is its ground truth. Errors if there is a ground truth.

    `scale`: of the second relative to the first, if it is free; `settings`: key, first's value, second's value;
    `only` (2,): verified edges that only one of them has, by frame numbers of the first.
    """

    first: Side
    second: Side
    laid: Evaluation
    scale: float
    frames: Ints  # (k,) frame of the first nearest to each compared pose
    errors: tuple[Evaluation | None, Evaluation | None]
    settings: tuple[tuple[str, Any, Any], ...]
    shared_edges: int
    only: tuple[frozenset[Pair], frozenset[Pair]]

    @property
    def distances_m(self) -> Floats:
        """(k,) distances between the two positions of each compared pose."""
        return self.laid.position_errors_m

    @property
    def angles_deg(self) -> Floats:
        """(k,) angles between the two rotations of each compared pose."""
        R = np.swapaxes(self.laid.T_true[:, :3, :3], 1, 2) @ self.laid.T_aligned[:, :3, :3]
        return se3.rotation_angle_deg(R)

    @property
    def farthest(self) -> str:
        """The frames where the two differ most, as runs of numbers."""
        count = max(1, round(FARTHEST_SHARE * len(self.frames)))
        return runs(np.unique(self.frames[np.argsort(-self.distances_m)[:count]]), most=6)


def read_side(path: Path, name: str, frames: ReportData | None = None, recording: Sequence | None = None) -> Side:
    """A results folder, or a trajectory: TUM, KITTI ... (`docs/recordings.md`), a COLMAP model, a transforms.json.

    `frames`: the result with the frames of the poses; `recording`: its recording, for the names of its images. Raises
    InputError.
    """
    named = None if (path / "trajectory.txt").is_file() else read_named_poses(path)
    if named is not None:
        if frames is None:
            raise InputError(f"{path}: poses by image name can only be the second: give a results folder first")
        names = [Path(frame.color.name).name for frame in recording.frames] if recording else []
        return Side(name, by_time(named, frames.frames.timestamp_s, names))
    if path.is_dir() and not (path / "trajectory.txt").is_file():
        raise InputError(f"{path} is neither a results folder, nor a COLMAP model, nor holds a transforms.json")
    run = run_of(path)
    if run is not None:
        return Side(name, run.trajectory, load(run.root))
    stamps = frames.frames.timestamp_s if frames else None
    counted = {"frames of the first result": stamps} if stamps is not None else {}
    return Side(name, read_trajectory(path, stamps, lambda: counted))


def compare(first: Side, second: Side, truth: Path | None = None, with_scale: bool = False) -> Comparison:
    """Align the second to the first. Raises MiniloopError if they have too few poses at the same times."""
    protocol = Protocol("Sim3" if with_scale else "SE3")
    try:
        laid = evaluate(second.trajectory, first.trajectory, protocol=protocol)
        free = evaluate(second.trajectory, first.trajectory, protocol=Protocol("Sim3"))
    except MiniloopError as error:
        raise MiniloopError(f"{second.name} cannot be aligned to {first.name}: {error}") from error
    stamps = first.run.frames.timestamp_s if first.run else first.trajectory.timestamps_s
    edges = [_verified(side, stamps) for side in (first, second)]
    return Comparison(
        first,
        second,
        laid,
        1 / float(free.numbers["scale"]),
        nearest(stamps, laid.timestamps_s),
        (_error(first, truth, protocol), _error(second, truth, protocol)),
        tuple(_different_settings(first, second)),
        len(edges[0] & edges[1]),
        (edges[0] - edges[1], edges[1] - edges[0]) if first.run and second.run else (frozenset(), frozenset()),
    )


def _error(side: Side, truth: Path | None, protocol: Protocol) -> Evaluation | None:
    if truth is None:
        return None
    folder = side.run.results if side.run else None
    return evaluate(side.trajectory, ground_truth(truth, side.trajectory.timestamps_s, folder), protocol=protocol)


def _verified(side: Side, stamps_s: Floats) -> frozenset[Pair]:
    """Verified edges, by the numbers of the first result's frames with their stamps."""
    if side.run is None:
        return frozenset()
    edges, own_s = side.run.edges, side.run.frames.timestamp_s
    number = nearest(stamps_s, own_s)
    same = np.abs(stamps_s[number] - own_s) < 1e-3
    rows = np.flatnonzero(edges.verified & same[edges.i] & same[edges.j])
    return frozenset(zip(number[edges.i[rows]].tolist(), number[edges.j[rows]].tolist(), strict=True))


def _different_settings(first: Side, second: Side) -> list[tuple[str, Any, Any]]:
    """Settings of config.yaml that are not the same in both runs; with the versions of miniloop."""
    if first.run is None or second.run is None:
        return []
    a, b = _settings(first.run), _settings(second.run)
    return [(key, a.get(key), b.get(key)) for key in sorted({*a, *b}) if a.get(key) != b.get(key)]


def _settings(run: ReportData) -> dict[str, Any]:
    path = run.results.root / "config.yaml"
    found: dict[str, Any] = {}
    if path.is_file():
        _flatten(load_plain(path.read_text(encoding="utf-8", errors="replace")), "", found)
    versions = run.summary.get("versions")
    if isinstance(versions, dict):
        found["(version of miniloop)"] = versions.get("miniloop")
    return found | {"frames of the run": len(run.frames), "--seed": run.summary.get("seed")}


def _flatten(value: Any, key: str, found: dict[str, Any]) -> None:
    if isinstance(value, dict):
        for name, inner in value.items():
            _flatten(inner, f"{key}.{name}" if key else str(name), found)
    else:
        found[key] = value
