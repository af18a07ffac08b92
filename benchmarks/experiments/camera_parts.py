"""What each part of the camera model is worth: recordings registered with more and more of it free."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from miniloop_cli.bench import Row
from miniloop_cli.bench.overlaps import open_with_truth
from miniloop_cli.datasets.intrinsics import default_camera
from miniloop_cli.evaluation.evaluate import Protocol, evaluate
from miniloop_cli.geometry.camera_parameters import DISTORTION, INTRINSICS
from miniloop_cli.geometry.depth_model import NAMES as DEPTH
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.refinement import self_calibration
from miniloop_cli.runtime.artifact_store import Artifact, Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.sequence import Sequence as Recording
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.stages.artifacts import REFINED

PROTOCOL = Protocol(association="nearest")  # as evo and the TUM scripts
MODELS: dict[str, tuple[str, ...]] = {
    "off": (),
    "focal, centre": INTRINSICS,
    "+ k1 k2": (*INTRINSICS, *DISTORTION[:2]),
    "+ p1 p2 k3": (*INTRINSICS, *DISTORTION),
    "+ depth offset, bend": (*INTRINSICS, *DISTORTION, *DEPTH[:2]),
    "+ depth radial": (*INTRINSICS, *DISTORTION, *DEPTH),
    "depth alone": DEPTH,
}


class EarlierStages(Store):
    """What comes before the refinement is taken from disk where it is there; the refinement is made in every run."""

    def load(self, artifact: Artifact, key: str) -> dict[str, NDArray[Any]] | None:
        """As Store.load."""
        return None if artifact == REFINED else super().load(artifact, key)

    def save(self, artifact: Artifact, key: str, arrays: dict[str, NDArray[Any]]) -> None:
        """As Store.save."""
        if artifact != REFINED:
            super().save(artifact, key, arrays)


@contextmanager
def ladder(models: tuple[tuple[str, ...], ...]) -> Iterator[None]:
    """Only these models are tried, each beside those before it."""
    usual = self_calibration.LADDER
    self_calibration.LADDER = models
    try:
        yield
    finally:
        self_calibration.LADDER = usual


def part_rows(sequences: Sequence[Path], cameras: Sequence[str], seed: int, workers: Workers) -> Iterator[Row]:
    """Rows of each recording, with its "own" camera and with TUM's ROS "default", and each of MODELS; then the choice.

    `cameras`: only these; empty: both.

    A model is taken if held-out tracks speak for it, as always. Seconds are those of the processor in the refinement.
    """
    for folder in sequences:
        recording, truth = open_with_truth(folder)
        default = replace(default_camera(), depth_scale=recording.camera.depth_scale, depth_scale_assumed=False)
        for short, name, camera in (("own", "its own", recording.camera), ("default", "ROS default", default)):
            if cameras and short not in cameras:
                continue
            if (camera.width, camera.height) != (recording.camera.width, recording.camera.height):
                continue
            sequence = replace(recording, camera=camera)
            for model, free in MODELS.items():
                with ladder((free,)):
                    yield _row(sequence, truth, name, model, "on" if free else "off", seed, workers)
            yield _row(sequence, truth, name, "chosen", "on", seed, workers)


def _row(
    sequence: Recording, truth: Trajectory, camera: str, model: str, calibrate: str, seed: int, workers: Workers
) -> Row:
    settings = load_settings("default", (f"calibrate={calibrate}",))
    run = register(sequence, settings, EarlierStages(default_folder()), workers, seed)
    posed, stamps, told = run.poses.registered, sequence.stamps_s, run.calibration
    found = Trajectory(stamps[posed], run.poses.T_world_cam[posed])
    row: Row = {"sequence": sequence.name, "camera": camera, "model": model, "registered": len(posed)}
    for key, protocol in (("ate_cm", PROTOCOL), ("scaled_cm", replace(PROTOCOL, alignment="Sim3"))):
        row[key] = round(100 * evaluate(found, truth, np.empty((0, 2)), protocol).numbers["ate_rmse_m"], 4)
    row |= {"changed": bool(told and told.changed), "gain": round(told.gain, 4) if told else None}
    row["fx"] = round(run.sequence.camera.fx, 2)
    return row | {"cpu_s": round(run.cpu_timings_s["refinement"], 2)}


def draw(rows: Sequence[Row]) -> Figure:
    """The error of each model, a colour for each recording and camera."""
    names = list(dict.fromkeys(row["model"] for row in rows))
    figure = Figure(figsize=(8, 1 + 0.35 * len(names)), layout="constrained")
    axes = figure.subplots()
    for sequence, camera in dict.fromkeys((row["sequence"], row["camera"]) for row in rows):
        mine = [row for row in rows if (row["sequence"], row["camera"]) == (sequence, camera)]
        axes.plot(
            [row["ate_cm"] for row in mine],
            [names.index(row["model"]) for row in mine],
            "o",
            label=f"{sequence}, {camera}",
        )
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set(xlabel="ATE rmse [cm]", xlim=(0, None))
    axes.legend(fontsize="x-small")
    return figure
