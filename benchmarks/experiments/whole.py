"""Whole recordings: `miniloop register` as it is called, beside ORB-SLAM3 and Open3D's reconstruction system."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.side_by_side import measured, open3d_system, vocabulary
from benchmarks.side_by_side.orbslam3_settings import settings_text
from benchmarks.side_by_side.run import Job, script
from miniloop_cli.bench import Row
from miniloop_cli.bench.overlaps import open_with_truth
from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import InputError, MiniloopError
from miniloop_cli.evaluation.evaluate import Protocol, evaluate
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.sequence import Sequence as Recording

MOST_DESCRIPTORS = 100_000  # that a vocabulary is learned from
WHEEL = "pyorbslam3"


@dataclass(frozen=True)
class Program:
    """A program of this name in the table; `prepare` makes its job of a recording, the folder to work in, a seed."""

    name: str
    prepare: Callable[[Path, Path, int], Job]


def whole_rows(
    sequences: Sequence[Path],
    programs: Sequence[str] = (),
    runs: Path = Path("results/whole"),
    open3d: Path | None = None,
    seed: int = 0,
    workers: Workers | None = None,
) -> Iterator[Row]:
    """One row a recording and program; `runs` keeps what each left. Programs that cannot run say why in their row.

    `open3d`: the folder with the programs of Open3D's reconstruction system, which takes long; without, it is left out.
    """
    known = PROGRAMS | {"open3d": Program("Open3D's reconstruction system", partial(open3d_job, open3d))}
    for folder in sequences:
        recording, _ = open_with_truth(folder)
        for name in programs or [name for name in known if open3d or name != "open3d"]:
            place = runs.resolve() / folder.resolve().name / name
            place.mkdir(parents=True, exist_ok=True)
            row: Row = {"sequence": folder.resolve().name, "frames": len(recording.with_color_only()[0].frames)}
            row |= {"program": known[name].name, "poses": None, "ate_cm": None, "rpe_deg": None, "rpe_cm": None}
            row |= {"cpu_s": None, "wall_s": None, "peak_mb": None, "said": ""}
            try:
                job = known[name].prepare(folder.resolve(), place, seed)
                subprocess.run([sys.executable, measured.__file__, str(job.out), *job.command], check=True)
                yield row | result(job, folder)
            except MiniloopError as error:
                yield row | {"said": str(error)}


def result(job: Job, folder: Path) -> Row:
    """What a job took, and how good the trajectory is that it left."""
    usage = json.loads(job.out.with_suffix(".usage.json").read_text(encoding="utf-8"))
    row: Row = {"cpu_s": usage["cpu"], "wall_s": usage["wall"], "peak_mb": usage["peak_mb"]}
    row["load_before"] = usage["load_before"]
    if usage["status"] != 0 or not job.out.with_suffix(".txt").is_file():
        lines = job.out.with_suffix(".log").read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return row | {"said": f"failed ({usage['status']}): {lines[-1] if lines else 'it said nothing'}"}
    told = job.out.with_suffix(".json")
    if told.is_file():  # watching it is not its own work
        row["cpu_s"] -= json.loads(told.read_text(encoding="utf-8")).get("watching_cpu_s", 0.0)
    return row | accuracy(job.out.with_suffix(".txt"), folder)


def accuracy(trajectory: Path, folder: Path) -> Row:
    """Poses, ATE over all of them, and relative errors of frames that follow each other in the recording.

    Ground truth: the nearest sample within 20 ms. Raises MiniloopError where there are fewer than three poses.
    """
    recording, truth = open_with_truth(folder)
    stamps = recording.with_color_only()[0].stamps_s
    pairs = np.stack([stamps[:-1], stamps[1:]], axis=1)
    found = evaluate(read_trajectory(trajectory, stamps), truth, pairs, Protocol(association="nearest")).numbers
    relative = found["rpe"]["edges"]
    row: Row = {"poses": found["poses"], "ate_cm": 100 * found["ate_rmse_m"], "pairs": relative["pairs"]}
    return row | {"rpe_deg": relative["rot_deg_mean"], "rpe_cm": 100 * relative["trans_m_mean"]}


def miniloop_job(folder: Path, place: Path, seed: int) -> Job:
    """`miniloop register` with defaults, report and model included, nothing taken from an earlier run."""
    return Job("miniloop", place / "run", script("register_run", folder, place / "run", "--seed", str(seed)))


def orbslam3_job(folder: Path, place: Path, seed: int, *more: str) -> Job:
    """ORB-SLAM3 with the recording's camera and a vocabulary of the recording's own features, learned beforehand."""
    if not importlib.util.find_spec(WHEEL):
        raise InputError(f"{WHEEL} is not installed: pip install {WHEEL} (Linux)")
    recording = open_sequence(folder)
    words, settings, frames = place.parent / "vocabulary.txt", place / "settings.yaml", place / "frames.txt"
    stamps = np.array([frame.timestamp_s for frame in recording.frames])
    settings.write_text(settings_text(recording.camera, 1 / float(np.median(np.diff(stamps)))), encoding="ascii")
    frames.write_text(frame_list(recording), encoding="utf-8")
    if not words.is_file():
        learn(recording, words, np.random.default_rng(seed))
    program = str(Path(vocabulary.__file__).with_name("orbslam3_run.py"))
    command = [sys.executable, program, str(frames), str(place / "run")]
    return Job("orbslam3", place / "run", [*command, "--vocabulary", str(words), "--settings", str(settings), *more])


def open3d_job(programs: Path | None, folder: Path, place: Path, seed: int) -> Job:
    """Open3D's reconstruction system with its default settings, from undistorted images, which are made beforehand."""
    if programs is None or not (programs / open3d_system.PROGRAM).is_file():
        raise InputError(f"--open3d names no folder with {open3d_system.PROGRAM}: it is in the sources of Open3D")
    images = place.parent / "undistorted"
    open3d_system.write_images(open_sequence(folder), images)
    more = ("--programs", str(programs.resolve()), "--images", str(images))
    return Job("open3d", place / "run", script("open3d_system", folder, place / "run", *more))


def frame_list(recording: Recording) -> str:
    """A line `stamp colour depth` a frame. Raises InputError for images that are not files of their own."""
    rows = []
    for frame in recording.frames:
        paths = [Path(source.name) for source in (frame.color, frame.depth)]
        if missing := next((path for path in paths if not path.is_file()), None):
            raise InputError(f"ORB-SLAM3 is given files, and {missing} is none: export the recording as TUM's layout")
        rows.append("\t".join([f"{frame.timestamp_s:.6f}", *(str(path.resolve()) for path in paths)]))
    return "\n".join(rows) + "\n"


def learn(recording: Recording, path: Path, rng: np.random.Generator) -> None:
    """A vocabulary of evenly spaced images of the recording, written whole or not at all."""
    step = max(len(recording.frames) * vocabulary.FEATURES // MOST_DESCRIPTORS, 1)
    images = [Path(frame.color.name) for frame in recording.frames[::step]]
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        vocabulary.write(Path(folder) / path.name, vocabulary.train(*vocabulary.orb_descriptors(images), rng))
        shutil.move(Path(folder) / path.name, path)


PROGRAMS: dict[str, Program] = {
    "miniloop": Program("miniloop register", miniloop_job),
    "orbslam3": Program("ORB-SLAM3, fed at 20 Hz", orbslam3_job),
    "orbslam3-waits": Program("ORB-SLAM3, waits for its mapping", lambda *given: orbslam3_job(*given, "--keep-up")),
}


def draw(rows: Sequence[Row]) -> Figure:
    """Accuracy beside CPU seconds."""
    figure = Figure(figsize=(6, 4.5), layout="constrained")
    axes = figure.subplots()
    done = [row for row in rows if row["ate_cm"] is not None]
    for row in done:
        axes.plot(row["cpu_s"], row["ate_cm"], "o", label=f"{row['program']}, {row['sequence']}")
    most_s, most_cm = (max((row[name] for row in done), default=1.0) for name in ("cpu_s", "ate_cm"))
    axes.set(xlabel="CPU seconds", ylabel="ATE [cm]", xlim=(0, 1.1 * most_s), ylim=(0, 1.1 * most_cm))
    figure.legend(loc="outside lower center", fontsize="small")
    return figure
