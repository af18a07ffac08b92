"""BENCHMARK.md from what run.py left in the results folder."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from benchmarks.side_by_side import sections
from benchmarks.side_by_side.sections import Json

LIBRARIES = ("numpy", "scipy", "numba", "opencv-contrib-python-headless", "open3d", "pycolmap", "gtsam", "faiss-cpu")
METHODS = {
    "miniloop": "miniloop",
    "miniloop-seed1": "miniloop, seed 1",
    "miniloop-seed2": "miniloop, seed 2",
    "miniloop-fast": "miniloop --config fast",
    "miniloop-paper": "miniloop --config paper",
    "open3d": "Open3D multiway, miniloop's matcher",
    "open3d-opencv": "Open3D multiway, OpenCV's matcher",
    "pycolmap": "pycolmap SfM, colour only, true scale given",
}
TABLES: dict[str, tuple[str, str, Callable[[Sequence[Json]], sections.Table]]] = {
    "whole": ("Whole recordings", sections.WHOLE_TEXT, sections.whole_recordings),
    "growth": ("From room to room", sections.GROWTH_TEXT, sections.growth),
}
REGENERATE = "python -m benchmarks run data/tum/freiburg1_xyz_100 data/tum/freiburg1_desk_100"


def read(path: Path) -> Json:
    """A JSON object, {} where there is no such file."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def machine() -> str:
    """Processor, cores, memory, versions."""
    model, memory = platform.processor() or platform.machine(), ""
    for line in _lines("/proc/cpuinfo"):
        if line.startswith("model name"):
            model = line.split(":", 1)[1].strip()
            break
    for line in _lines("/proc/meminfo"):
        if line.startswith("MemTotal"):
            memory = f", {int(line.split()[1]) / 2**20:.0f} GB of memory"
    libraries = []
    for name in LIBRARIES:
        try:
            libraries.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            libraries.append(f"{name} not installed")
    python = f"{platform.system()}, Python {platform.python_version()}"
    return f"{model}, {os.cpu_count()} cores{memory}; {python}; {', '.join(libraries)}."


def _lines(path: str) -> list[str]:
    return Path(path).read_text(encoding="utf-8").splitlines() if Path(path).is_file() else []


def loads(results: Path) -> str:
    """How busy the machine was with other things."""
    found = [read(path)["load_before"] for path in sorted(results.rglob("*.usage.json"))]
    if not found:
        return ""
    mean = sum(found) / len(found)
    busy = mean > 0.5 * (os.cpu_count() or 1)
    text = f"Load average before the runs: mean {mean:.1f}, at most {max(found):.1f}."
    return text + (
        " The machine was shared: wall seconds are upper bounds, CPU seconds are what compares." if busy else ""
    )


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A Markdown table; numbers to the right."""
    lines = ["| " + " | ".join(head) + " |", "|" + "|".join(["---"] + ["---:"] * (len(head) - 1)) + "|"]
    return "\n".join(lines + ["| " + " | ".join(map(sections.text, row)) + " |" for row in rows])


def write(sequences: Sequence[Path], results: Path, output: Path) -> None:
    """Write BENCHMARK.md."""
    parts = [
        "# Benchmarks",
        f"miniloop and others on the same frames, one after the other, each in a process of its own. "
        f"Written by `{REGENERATE}`; every number is measured there, none is typed in.",
        machine() + " " + loads(results),
        sections.PROTOCOL_TEXT,
    ]
    matching = {sequence.name: read(results / sequence.name / "matching.json") for sequence in sequences}
    for sequence in sequences:
        folder = results / sequence.name
        runs = {
            name: read(folder / f"{key}.json") | {"usage": read(folder / f"{key}.usage.json")}
            for key, name in METHODS.items()
        }
        runs = {name: run for name, run in runs.items() if "stages" in run}
        paths = {name: folder / f"{key}.txt" for key, name in METHODS.items()}
        if runs:
            parts += [f"## {sequence.name}", table(*sections.whole_runs(runs, paths, sequence))]
            parts += [sections.ratios(runs), table(*sections.stages(runs))]
        if again := read(folder / "again.json"):
            parts += [sections.AGAIN_TEXT, table(*sections.again(again, runs))]
        if same := read(folder / "same-poses.json"):
            parts += [sections.same_poses_text(same), table(*sections.same_poses(same, folder, sequence))]
        if ablation := read(folder / "ablation.json"):
            parts += [sections.ABLATION_TEXT, table(*sections.ablation(ablation))]
    if any(matching.values()):
        parts += ["## Matching", sections.MATCHING_TEXT, table(*sections.matching(matching))]
    averaging = [row for path in sorted(results.glob("averaging-?.json")) for row in read(path).get("rows", [])]
    if averaging:
        parts += ["## Averaging at scale", sections.AVERAGING_TEXT, table(*sections.averaging(averaging))]
    scaling = {int(p.stem.split("-")[1]): p for p in results.glob("scaling-*.json") if "usage" not in p.name}
    if scaling:
        longer = {n: read(p) | {"usage": read(p.with_suffix(".usage.json"))} for n, p in sorted(scaling.items())}
        found = {n: sections.scores(p.with_suffix(".txt"), results / f"simulated_{n}") for n, p in scaling.items()}
        parts += ["## Longer recordings", sections.SCALING_TEXT, table(*sections.scaling(longer, found))]
    for name, (title, words, make) in TABLES.items():
        if rows := read(results / f"{name}.json").get("rows"):
            parts += [f"## {title}", words, table(*make(rows))]
    output.write_text("\n\n".join(part for part in parts if part) + "\n", encoding="utf-8")


def update(name: str, rows: Sequence[Json], output: Path) -> None:
    """Replace the section of one of TABLES in BENCHMARK.md, or put it at the end; the others stay."""
    title, words, make = TABLES[name]
    head, *found = output.read_text(encoding="utf-8").rstrip().split("\n## ")
    new = "\n\n".join([title, words, machine(), table(*make(rows))])
    kept = [new if section.startswith(f"{title}\n") else section.rstrip() for section in found]
    kept += [] if new in kept else [new]
    output.write_text("\n\n## ".join([head.rstrip(), *kept]) + "\n", encoding="utf-8")
