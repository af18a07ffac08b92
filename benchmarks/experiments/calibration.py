"""What the covariances of poses are worth: errors on simulated recordings in units of what is promised."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.special import erf

from benchmarks.experiments.pose_errors import aligned_errors, normalised_errors, within_2_sigma
from miniloop_cli.bench import Row
from miniloop_cli.bench.overlaps import open_with_truth
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.registration import RegistrationError
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence
from miniloop_cli.typing import Floats

PATHS = ("loop", "xyz", "random-walk", "rotation")
WANTED = (0.90, 0.98)
SIGMAS = np.linspace(0, 4, 17)


def calibration_rows(
    frames: Iterable[int], noise: Iterable[float], seeds: int, width: int, seed: int, workers: Workers
) -> Iterator[Row]:
    """A row a path, level of noise (times that of a Kinect) and number of frames, its `seeds` recordings pooled.

    `rotation_shares`, `translation_shares`: of the errors, those within each of SIGMAS.
    """
    for count, path, level in product(frames, PATHS, noise):
        head: Row = {"path": path, "noise": level, "frames": count, "runs": seeds}
        runs = [_run(path, level, count, each, width, workers) for each in range(seed, seed + seeds)]
        normalised = np.concatenate([run[0] for run in runs])
        error_cm, error_deg, sigma_cm = (np.concatenate([run[k] for run in runs]) for k in (1, 2, 3))
        row = head | {"poses": len(normalised), "within_2_sigma": within_2_sigma(normalised)}
        row |= {
            "rotation_within": within_2_sigma(normalised[:, :3]),
            "translation_within": within_2_sigma(normalised[:, 3:]),
        }
        for name, values in (("error_cm", error_cm), ("error_deg", error_deg), ("promised_cm", sigma_cm)):
            row[f"{name}_rms"] = float(np.sqrt((values**2).mean())) if len(values) else None
        row |= {"rotation_shares": _shares(normalised[:, :3]), "translation_shares": _shares(normalised[:, 3:])}
        yield {k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}


def _shares(normalised: Floats) -> list[float] | None:
    """Shares of the entries (k, 3) that are at most so large; None without any."""
    return [round(float((np.abs(normalised) <= limit).mean()), 4) for limit in SIGMAS] if normalised.size else None


def _run(
    path: str, noise: float, frames: int, seed: int, width: int, workers: Workers
) -> tuple[Floats, Floats, Floats, Floats]:
    """Errors in sigmas (k, 6), in cm and degrees after alignment, and promised sigmas of positions (cm)."""
    nothing = np.zeros((0, 6)), np.zeros(0), np.zeros(0), np.zeros(0)
    settings = SimulationSettings(frames=frames, width=width, height=width * 3 // 4, path=path, noise_level=noise)
    with tempfile.TemporaryDirectory() as root:
        sequence, truth = open_with_truth(write_sequence(Path(root) / "recording", settings, seed))
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


def draw(rows: Sequence[Row]) -> Figure:
    """Share within 2 sigma of every row; errors in sigmas against a normal distribution; errors against noise."""
    figure = Figure(figsize=(12, 3.8), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    rows = [row for row in rows if row["poses"]]
    left.axvspan(*(100 * limit for limit in WANTED), color="tab:green", alpha=0.15)
    left.plot([100 * row["within_2_sigma"] for row in rows], range(len(rows)), "o")
    left.set_yticks(
        range(len(rows)), [f"{row['path']}, noise x {row['noise']:g}, {row['frames']}" for row in rows], fontsize=6
    )
    left.set(xlabel="errors within 2 sigma [%]", ylim=(len(rows) - 0.5, -0.5))
    for name in ("rotation", "translation") if rows else ():
        shares = np.average([row[f"{name}_shares"] for row in rows], axis=0, weights=[row["poses"] for row in rows])
        middle.plot(SIGMAS, 100 * shares, "o-", markersize=3, label=name)
    x = np.linspace(0, 4, 81)
    middle.plot(x, 100 * erf(x / np.sqrt(2)), "k:", label="normal distribution")
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
    return figure
