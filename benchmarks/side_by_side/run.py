"""miniloop and others on the same frames, one after the other, each in a process of its own; writes BENCHMARK.md."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.side_by_side.measured import measure
from benchmarks.side_by_side.sections import edge_list

AVERAGING = (
    ["--scans", "1000", "--edges", "5000", "--outliers", "0.05", "--peers"],
    ["--scans", "10000", "--edges", "50000", "--outliers", "0.05", "--peers"],
    ["--scans", "10000", "--edges", "50000", "--outliers", "0.1", "--kind", "expander", "--peers"],
    ["--scans", "100000", "--edges", "500000", "--outliers", "0.05"],
)
SIMULATED_FRAMES = (100, 300, 1000, 2000)
ON_DEMAND = ("scaling",)  # takes hours


@dataclass(frozen=True)
class Job:
    """A command that leaves `out`.json, run and measured as a whole."""

    part: str
    out: Path
    command: list[str]


def script(name: str, sequence: Path, out: Path, *more: str) -> list[str]:
    """The command line of a program of this folder."""
    return [sys.executable, "-m", f"benchmarks.side_by_side.{name}", str(sequence), str(out), *more]


def bench(out: Path, *arguments: str) -> list[str]:
    """The command line of a measurement of miniloop itself."""
    command = [sys.executable, "-m", "benchmarks", *arguments]
    return [*command, "-o", str(out), "-q", "--json", str(out.with_suffix(".json"))]


def jobs(sequences: list[Path], results: Path) -> list[Job]:
    """All jobs in order. First, short runs compile what is compiled; they are not reported."""
    found = []
    for config in ("default", "fast", "paper"):
        out = results / f"warm-up-{config}"
        command = script("miniloop_run", sequences[0], out, "--config", config, "--max-frames", "30")
        found.append(Job("warm-up", out, command))
    for sequence in sequences:
        folder = results / sequence.name

        def add(part: str, name: str, *more: str, sequence: Path = sequence, folder: Path = folder) -> None:
            found.append(Job(part, folder / part, script(name, sequence, folder / part, *more)))

        add("miniloop", "miniloop_run")
        add("miniloop-seed1", "miniloop_run", "--seed", "1")
        add("miniloop-seed2", "miniloop_run", "--seed", "2")
        add("miniloop-fast", "miniloop_run", "--config", "fast")
        add("miniloop-paper", "miniloop_run", "--config", "paper")
        add("open3d", "open3d_multiway")
        add("open3d-opencv", "open3d_multiway", "--matcher", "opencv")
        add("pycolmap", "pycolmap_sfm")
        add("again", "again")
        add("same-poses", "same_poses")
        add("matching", "matching")
        edges = ["--edges", str(edge_list(sequence))] if edge_list(sequence).is_file() else []
        out = folder / "ablation"
        found.append(Job("ablation", out, bench(out, "ablation", str(sequence), *edges)))
    for k, arguments in enumerate(AVERAGING):
        found.append(
            Job("averaging", results / f"averaging-{k}", bench(results / f"averaging-{k}", "averaging", *arguments))
        )
    for frames in SIMULATED_FRAMES:
        out, sequence = results / f"scaling-{frames}", results / f"simulated_{frames}"
        found.append(Job("scaling", out, script("miniloop_run", sequence, out)))
    return found


def simulate(job: Job) -> None:
    """The recording that a job of part "scaling" registers, made where it is missing."""
    frames = job.out.name.split("-")[1]
    folder = job.out.with_name(f"simulated_{frames}")
    if not folder.exists():
        options = ["--frames", frames, "--path", "random-walk", "--width", "320", "--height", "240"]
        subprocess.run([sys.executable, "-m", "miniloop_cli", "simulate", str(folder), *options, "-q"], check=True)


def run(sequences: Sequence[Path], results: Path, parts: Collection[str] = (), without: Collection[str] = ()) -> None:
    """Measure all parts, those named `parts` alone, or all but those `without`; then record them in results.json.

    What is not measured now keeps what the folder `results` holds of it. Parts ON_DEMAND have to be named.
    """
    for job in jobs([path.resolve() for path in sequences], results.resolve()):
        wanted = job.part in parts if parts else job.part not in (*ON_DEMAND, *without)
        if wanted or job.part == "warm-up":
            if job.part == "scaling":
                simulate(job)
            measure(job.out, job.command)
    from benchmarks.side_by_side.report import record  # late: the parent's memory counts in that of its children

    record(sequences, results)
