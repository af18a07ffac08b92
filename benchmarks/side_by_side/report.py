"""What run.py left in the results folder becomes tables of results.json."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmarks.figures.pages import update
from benchmarks.figures.store import Figures, load, put_table, save
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
    "certificate-large": ("certificate-large.video", "The certificate of larger graphs", sections.certificates),
    "averaging": ("averaging.scale", "Averaging of ever larger view graphs", sections.averaging_scale),
    "camera-parts": ("camera-parts.models", "What each part of the camera is worth", sections.camera_parts),
    "whole": ("whole.recordings", "Whole recordings", sections.whole_recordings),
    "growth": ("growth.rooms", "Walks through many rooms", sections.growth),
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
    return f"{model}, {os.cpu_count()} cores{memory}; {python}; {', '.join(libraries)}"


def _lines(path: str) -> list[str]:
    return Path(path).read_text(encoding="utf-8").splitlines() if Path(path).is_file() else []


def loads(results: Path) -> str:
    """How busy the machine was with other things."""
    return _busy([read(path)["load_before"] for path in sorted(results.rglob("*.usage.json"))])


def _busy(found: Sequence[float]) -> str:
    """The load averages before some runs, in words."""
    if not found:
        return ""
    mean = sum(found) / len(found)
    busy = mean > 0.5 * (os.cpu_count() or 1)
    text = f"Load average before the runs: mean {mean:.1f}, at most {max(found):.1f}."
    return text + (
        " The machine was shared: wall seconds are upper bounds, CPU seconds are what compares." if busy else ""
    )


def record(sequences: Sequence[Path], results: Path) -> None:
    """Put what the folder `results` holds into results.json, and bring the pages up to date."""
    figures = load()
    note_run(figures, "side-by-side", REGENERATE, loads(results))
    for key, what, made in _tables(sequences, results):
        put_table(figures, f"side-by-side.{key}", what, made)
    for sequence in sequences:
        if same := read(results / sequence.name / "same-poses.json"):
            key = f"side-by-side.{short(sequence)}.edges"
            what = f"Edges that poses are made from, {sequence.name}"
            figures.values[key] = {"what": what, "unit": "", "value": same["edges"], "run": "side-by-side"}
    save(figures)
    update(figures, check=False)


def record_rows(name: str, rows: Sequence[Json]) -> None:
    """Put the table of NAME, a key of TABLES, into results.json, and bring the pages up to date."""
    key, what, make = TABLES[name]
    figures = load()
    note_run(figures, name, _command(name, rows), _busy([row["load"] for row in rows if row.get("load")]))
    put_table(figures, key, what, make(rows))
    save(figures)
    update(figures, check=False)


def _command(name: str, rows: Sequence[Json]) -> str:
    """The command that measures rows such as these."""
    if name not in ("averaging", "certificate-large"):
        return f"python -m benchmarks {name}"
    scans = " ".join(f"--scans {count}" for count in dict.fromkeys(row["scans"] for row in rows))
    return f"python -m benchmarks averaging {scans}" + (" --certificate" if name == "certificate-large" else "")


def note_run(figures: Figures, name: str, command: str, note: str = "") -> None:
    """Say of a run what was measured, when, with which sources and where."""
    git = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    today = datetime.now(UTC).date().isoformat()
    figures.runs[name] = {"command": command, "date": today, "commit": git.stdout.strip(), "machine": machine()}
    if note:
        figures.runs[name]["note"] = note


def short(sequence: Path) -> str:
    """What a recording is called in keys: xyz for freiburg1_xyz_100."""
    return sequence.name.removeprefix("freiburg1_").removesuffix("_100")


def _tables(sequences: Sequence[Path], results: Path) -> Iterable[tuple[str, str, sections.Table]]:
    """(key, what it is, table) of everything that was measured."""
    for sequence in sequences:
        folder, key, on = results / sequence.name, short(sequence), f", {sequence.name}"
        runs = {
            name: read(folder / f"{method}.json") | {"usage": read(folder / f"{method}.usage.json")}
            for method, name in METHODS.items()
        }
        runs = {name: run for name, run in runs.items() if "stages" in run}
        paths = {name: folder / f"{method}.txt" for method, name in METHODS.items()}
        if runs:
            yield f"{key}.runs", "Accuracy and cost" + on, sections.whole_runs(runs, paths, sequence)
            yield f"{key}.stages", "Seconds a stage" + on, sections.stages(runs)
        if again := read(folder / "again.json"):
            yield f"{key}.again", "A second run with one setting changed" + on, sections.again(again, runs)
        if same := read(folder / "same-poses.json"):
            made = sections.same_poses(same, folder, sequence)
            yield f"{key}.same-poses", "Averaging and pose graphs on the same edges" + on, made
        if ablation := read(folder / "ablation.json"):
            yield f"{key}.ablation", "One thing changed at a time" + on, sections.ablation(ablation)
    matching = {sequence.name: read(results / sequence.name / "matching.json") for sequence in sequences}
    if any(matching.values()):
        yield "matching", "Matchers on the same features", sections.matching(matching)
    averaging = [row for path in sorted(results.glob("averaging-?.json")) for row in read(path).get("rows", [])]
    if averaging:
        yield "averaging", "View graphs with known poses", sections.averaging(averaging)
    scaling = {int(p.stem.split("-")[1]): p for p in results.glob("scaling-*.json") if "usage" not in p.name}
    if scaling:
        longer = {n: read(p) | {"usage": read(p.with_suffix(".usage.json"))} for n, p in sorted(scaling.items())}
        found = {n: sections.scores(p.with_suffix(".txt"), results / f"simulated_{n}") for n, p in scaling.items()}
        yield "scaling", "Simulated recordings of growing length", sections.scaling(longer, found)
