"""What the covariances of poses are worth: errors on simulated recordings in units of what is promised."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.experiments.pose_errors import aligned_errors, normalised_errors, within_2_sigma
from miniloop_cli.datasets import open_sequence, read_ground_truth
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.registration import RegistrationError
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence
from miniloop_cli.typing import Floats

Row = dict[str, Any]

PATHS = ("loop", "xyz", "random-walk", "rotation")
NOISE = (0.5, 1.0, 2.0)  # times that of a Kinect
WANTED = (0.90, 0.98)


@dataclass(frozen=True)
class Cell:
    """One kind of recording: errors (k, 6) in sigmas of all its runs, and their sizes."""

    row: Row
    normalised: Floats = field(default_factory=lambda: np.zeros((0, 6)))


def calibration_cells(
    paths: Iterable[str] = PATHS,
    noise: Iterable[float] = NOISE,
    frames: Iterable[int] = (16, 32),
    seeds: Sequence[int] = (0, 1),
    width: int = 320,
    workers: Workers | None = None,
) -> Iterator[Cell]:
    """One cell a path, level of noise and number of frames, its seeds pooled."""
    for count, path, level in product(frames, paths, noise):
        head = {"path": path, "noise": level, "frames": count, "runs": len(seeds)}
        runs = [_run(path, level, count, seed, width, workers or Workers()) for seed in seeds]
        normalised = np.concatenate([run[0] for run in runs])
        error_cm, error_deg, sigma_cm = (np.concatenate([run[k] for run in runs]) for k in (1, 2, 3))
        row = head | {"poses": len(normalised), "within_2_sigma": within_2_sigma(normalised)}
        row |= {
            "rotation_within": within_2_sigma(normalised[:, :3]),
            "translation_within": within_2_sigma(normalised[:, 3:]),
        }
        for name, values in (("error_cm", error_cm), ("error_deg", error_deg), ("promised_cm", sigma_cm)):
            row[f"{name}_rms"] = float(np.sqrt((values**2).mean())) if len(values) else None
        yield Cell({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}, normalised)


def _run(
    path: str, noise: float, frames: int, seed: int, width: int, workers: Workers
) -> tuple[Floats, Floats, Floats, Floats]:
    """Errors in sigmas (k, 6), in cm and degrees after alignment, and promised sigmas of positions (cm)."""
    nothing = np.zeros((0, 6)), np.zeros(0), np.zeros(0), np.zeros(0)
    settings = SimulationSettings(frames=frames, width=width, height=width * 3 // 4, path=path, noise_level=noise)
    with tempfile.TemporaryDirectory() as root:
        sequence = open_sequence(write_sequence(Path(root) / "recording", settings, seed))
        truth = read_ground_truth(sequence)
        try:
            run = register(sequence, load_settings(), Store(default_folder()), workers, 0)
        except RegistrationError:
            return nothing
    posed = run.poses.registered
    T_true = associate(np.array([frame.timestamp_s for frame in sequence.frames]), truth)[0][posed]
    T, covariance = run.poses.T_world_cam[posed], run.covariance[posed]
    metres, degrees = aligned_errors(T, T_true)
    sigma_m = np.sqrt(np.einsum("naa->n", covariance[:, 3:, 3:]))
    return normalised_errors(T, T_true, covariance), 100 * metres, degrees, 100 * sigma_m[np.isfinite(sigma_m)]


def draw(cells: Sequence[Cell], path: Path) -> None:
    """Share within 2 sigma of every cell; errors in sigmas against a normal distribution; errors against noise."""
    from matplotlib.figure import Figure
    from scipy.stats import norm

    figure = Figure(figsize=(12, 3.8), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    rows = [cell.row for cell in cells if cell.row["poses"]]
    left.axvspan(*(100 * limit for limit in WANTED), color="tab:green", alpha=0.15)
    left.plot([100 * row["within_2_sigma"] for row in rows], range(len(rows)), "o")
    left.set_yticks(
        range(len(rows)), [f"{row['path']}, noise x {row['noise']:g}, {row['frames']}" for row in rows], fontsize=6
    )
    left.set(xlabel="errors within 2 sigma [%]", ylim=(len(rows) - 0.5, -0.5))
    everything = np.concatenate([cell.normalised for cell in cells])
    x = np.linspace(0, 4, 81)
    for name, part in (("rotation", everything[:, :3]), ("translation", everything[:, 3:])):
        if part.size:
            middle.plot(x, [100 * (np.abs(part) <= limit).mean() for limit in x], label=name)
    middle.plot(x, 100 * (2 * norm.cdf(x) - 1), "k:", label="normal distribution")
    middle.set(xlabel="error [sigma]", ylabel="errors below [%]")
    middle.legend(fontsize="x-small")
    for k, name in enumerate(dict.fromkeys(row["path"] for row in rows)):
        mine = [row for row in rows if row["path"] == name]
        right.plot(
            [row["noise"] for row in mine], [row["error_cm_rms"] for row in mine], "o", color=f"C{k}", label=name
        )
        right.plot([row["noise"] for row in mine], [row["promised_cm_rms"] for row in mine], "_", color=f"C{k}", ms=12)
    right.set(xlabel="noise [times a Kinect's]", ylabel="position error, rms [cm] (-: promised)", ylim=(0, None))
    right.legend(fontsize="x-small")
    with atomic_write(path, "wb") as file:
        figure.savefig(file, format="png", dpi=120)
