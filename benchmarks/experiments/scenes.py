"""Scenes that defeat programs of this kind, each with the answer that is right for it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.experiments.pose_errors import aligned_errors, normalised_errors, within_2_sigma
from miniloop_cli.bench import Row
from miniloop_cli.bench.overlaps import open_with_truth
from miniloop_cli.errors import ConfigError
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.results.tables import frame_status
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.registration import Registration, RegistrationError
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence


@dataclass(frozen=True)
class Scene:
    """A simulated recording (`changes` to the settings) and the right answer.

    `expected` in words: at least `least` and at most `most` of the frames are registered, those that are within
    `most_cm` of the truth (rmse); every other frame says why.
    """

    expected: str
    changes: dict[str, Any] = field(default_factory=dict)
    least: float = 1.0
    most: float = 1.0
    most_cm: float = 2.0


MOVING = {"moving_object": True, "path_share": 0.3}
ROLLING = {"blur_s": 0.03, "rolling_shutter_s": 0.03}
SCENES: dict[str, Scene] = {
    "room": Scene("all poses"),
    "no texture": Scene("nothing registered", {"scene": "textureless"}, least=0, most=0),
    "repeated texture": Scene("right poses or none", {"scene": "repeated"}, least=0),
    "one plane": Scene("all poses", {"scene": "plane", "path": "xyz"}),
    "pure rotation": Scene("nearly all poses", {"path": "rotation"}, least=0.9),
    "no motion": Scene("all poses", {"path": "still"}, most_cm=0.5),
    "moving person": Scene("right poses or none", MOVING, least=0, most_cm=3),
    "moving person, masked": Scene("most poses", MOVING | {"masks": True}, least=0.8, most_cm=3),
    "no depth beyond 3 m": Scene("nearly all poses", {"depth_limit_m": 3.0}, least=0.9),
    "over-exposed": Scene("right poses, as far as there are any", {"exposure": 3.0}, least=0, most_cm=5),
    "rolling blur": Scene("most poses", ROLLING | {"rate_hz": 3.0}, least=0.8),
    "rolling blur, fast": Scene("right poses, as far as there are any", ROLLING, least=0, most_cm=5),
    "one frame": Scene("nothing registered", {"frames": 1}, least=0, most=0),
    "two frames": Scene("both poses", {"frames": 2, "path_share": 0.02}),
    "three frames": Scene("all poses", {"frames": 3, "path_share": 0.05}),
    "near-identical frames": Scene("all poses", {"frames": 200, "path_share": 0.02}),
    "two rooms": Scene("one room; the other one named as a piece", {"scene": "two-rooms"}, least=0.4, most=0.5),
}


def scene_rows(
    only: Sequence[str] = (),
    frames: int = 30,
    width: int = 640,
    seeds: int = 1,
    seed: int = 0,
    workers: Workers | None = None,
) -> Iterator[Row]:
    """One row a scene, or `only` of those named, and each of so many `seeds`, from `seed` on.

    Scenes of few or many frames keep their number. Raises ConfigError for an unknown name.
    """
    if unknown := [name for name in only if name not in SCENES]:
        raise ConfigError(f"no scene '{unknown[0]}'; known are: {', '.join(SCENES)}")
    for name in only or SCENES:
        for each in range(seed, seed + seeds):
            yield scene_row(name, SCENES[name], frames, width, each, workers or Workers())


def scene_row(name: str, scene: Scene, frames: int, width: int, seed: int, workers: Workers) -> Row:
    """What miniloop makes of one scene, with default settings."""
    size = {"frames": frames, "width": width, "height": width * 3 // 4}
    with tempfile.TemporaryDirectory() as root:
        folder = write_sequence(Path(root) / "scene", SimulationSettings(**(size | scene.changes)), seed)
        sequence, truth = open_with_truth(folder)
        run, problem = None, ""
        try:
            run = register(sequence, load_settings(), Store(default_folder()), workers, 0)
        except RegistrationError as error:
            problem = str(error)
    T_true, _ = associate(np.array([frame.timestamp_s for frame in sequence.frames]), truth)
    count = len(sequence.frames)
    row: Row = {"scene": name, "seed": seed, "expected": scene.expected, "frames": count}
    row |= {"registered": 0, "ate_cm": None, "rot_deg": None, "within_2_sigma": None, "verdict": problem}
    silent = False
    if run is not None:
        posed = run.poses.registered
        T, T_posed, covariance = run.poses.T_world_cam[posed], T_true[posed], run.covariance[posed]
        lost = sorted(set(range(count)) - set(posed.tolist()))
        silent = not all(frame_status(run, k)[1] for k in lost)
        row |= {"registered": len(posed), "verdict": _said(run, lost, count)}
        row["ate_cm"], row["rot_deg"] = (
            float(np.sqrt((e**2).mean())) * scale for e, scale in zip(aligned_errors(T, T_posed), (100, 1), strict=True)
        )
        row["within_2_sigma"] = within_2_sigma(normalised_errors(T, T_posed, covariance))
    right = scene.least * count - 1e-9 <= row["registered"] <= scene.most * count + 1e-9 and not silent
    right &= row["ate_cm"] is None or row["ate_cm"] <= scene.most_cm
    return {k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()} | {"as_expected": bool(right)}


def _said(run: Registration, lost: Sequence[int], count: int) -> str:
    """What the run says of itself: how many frames have a pose, and why the first of the others has none."""
    said = f"{count - len(lost)} of {count} frames registered"
    return said + (f"; frame {lost[0]}: {frame_status(run, lost[0])[1]}" if lost else "")


def draw(rows: Sequence[Row]) -> Figure:
    """Share of frames registered and error of each scene; green as expected, red not."""
    figure = Figure(figsize=(9, 1 + 0.3 * len(rows)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    colors = ["tab:green" if row["as_expected"] else "tab:red" for row in rows]
    left.barh(range(len(rows)), [100 * row["registered"] / row["frames"] for row in rows], color=colors)
    right.barh(range(len(rows)), [row["ate_cm"] or 0 for row in rows], color=colors)
    left.set_yticks(range(len(rows)), [f"{row['scene']}, seed {row['seed']}" for row in rows])
    left.set(xlabel="frames registered [%]", xlim=(0, 100), ylim=(len(rows) - 0.5, -0.5))
    right.set(xlabel="position error, rmse [cm]")
    return figure
