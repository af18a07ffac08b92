"""What every measured program shares: seconds of its stages, and the files in which it leaves its result."""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def arguments(description: str, **more: Any) -> argparse.Namespace:
    """`SEQ OUT` and an option `--name VALUE` for each of `more` (name=default).

    OUT is a path without suffix: OUT.json and OUT.txt are written.
    """
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("sequence", type=Path)
    parser.add_argument("out", type=Path)
    for name, default in more.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(default), default=default)
    return parser.parse_args()


class Clock:
    """Wall-clock seconds and CPU seconds (user and system, all threads, children that have ended) of named stages."""

    def __init__(self) -> None:
        self.stages: dict[str, dict[str, float]] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the seconds of the block to a stage."""
        wall, cpu = time.perf_counter(), _cpu_s()
        yield
        spent = self.stages.setdefault(name, {"wall": 0.0, "cpu": 0.0})
        spent["wall"] += time.perf_counter() - wall
        spent["cpu"] += _cpu_s() - cpu


def _cpu_s() -> float:
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in usage)


def write_result(out: Path, data: dict[str, Any]) -> None:
    """OUT.json."""
    out.with_suffix(".json").write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def write_poses(out: Path, stamps_s: NDArray[np.float64], T_world_cam: NDArray[np.float64]) -> None:
    """OUT.txt: poses (k, 4, 4), camera to world, at (k,) stamps, in TUM's format."""
    from miniloop_cli.datasets.trajectory import write_trajectory
    from miniloop_cli.scene.sequence import Trajectory

    write_trajectory(out.with_suffix(".txt"), Trajectory(stamps_s, T_world_cam))
