"""What it costs to add a recording to a map, and how far the result is from registering all of them together."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.mapping.pieces import moved_onto


def show_added(paths: tuple[Path, ...], overrides: tuple[str, ...]) -> None:
    """The last recording added to the map of the others: seconds, bytes, and the difference to all registered together.

    Each command is a process of its own that computes everything again.
    """
    *others, added = paths
    chosen = [word for override in overrides for word in ("--set", override)]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        rows = [
            ("the others", _run("register", *others, "-o", folder / "map", *chosen)),
            ("the last one alone", _run("register", added, "-o", folder / "alone", *chosen)),
        ]
        numbers = _numbers(folder / "map")
        rows.append(("the last one added", _run("add", folder / "map", added)))
        rows.append(("all together", _run("register", *paths, "-o", folder / "together", *chosen)))
        print(f"{numbers['keyframes']} keyframes, {numbers['bytes'] / 1000 / numbers['keyframes']:.0f} kB each")
        print("| | CPU s | wall s | peak MB |")
        print("|---|---:|---:|---:|")
        for name, (cpu_s, wall_s, peak_mb) in rows:
            print(f"| {name} | {cpu_s:.1f} | {wall_s:.1f} | {peak_mb:.0f} |")
        print(f"added / alone: {rows[2][1][0] / rows[1][1][0]:.2f} of the CPU time")
        names = [recording["name"] for recording in _numbers(folder / "map")["recordings"]]
        print("| against all together | median cm | largest cm | median deg | largest deg |")
        print("|---|---:|---:|---:|---:|")
        for name, cm, deg in differences(folder / "map", folder / "together", names):
            values = (f(v) for v, digits in ((cm, 3), (deg, 4)) for f in (np.median, np.max))
            print(f"| {name} | " + " | ".join(f"{value:.3f}" for value in values) + " |")


def differences(a: Path, b: Path, names: list[str]) -> list[tuple[str, Any, Any]]:
    """Of each recording centimetres and degrees (n,) between two maps, one laid onto the other as a whole."""
    found = [[read_trajectory(side / name / "trajectory.txt").T_world_cam for name in names] for side in (a, b)]
    onto = moved_onto(*(np.concatenate(side) for side in found))
    rows = []
    for name, P, Q in zip(names, *found, strict=True):
        E = se3.inverse(Q) @ onto @ P
        rows.append((name, 100 * np.linalg.norm(E[:, :3, 3], axis=1), se3.rotation_angle_deg(E[:, :3, :3])))
    return rows


def _numbers(result: Path) -> dict[str, Any]:
    return json.loads((result / "summary.json").read_text())


def _run(*arguments: object) -> tuple[float, float, float]:
    """CPU seconds, wall seconds and peak MB of a command. Raises MiniloopError if it fails."""
    code = (
        "import json, resource, subprocess, sys, time\n"
        "begin = time.perf_counter()\n"
        "status = subprocess.run(sys.argv[1:]).returncode\n"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(json.dumps([used.ru_utime + used.ru_stime, time.perf_counter() - begin, used.ru_maxrss / 1000]))\n"
        "sys.exit(status)\n"
    )
    line = [sys.executable, "-c", code, sys.executable, "-m", "miniloop_cli", *map(str, arguments), "-q", "--fresh"]
    done = subprocess.run(line, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise MiniloopError(f"miniloop {arguments[0]} ended with status {done.returncode}; its error is above")
    cpu_s, wall_s, peak_mb = json.loads(done.stdout.splitlines()[-1])
    return cpu_s, wall_s, peak_mb
