"""Three calls that do what the command line does: `register`, `evaluate`, `simulate`."""

from __future__ import annotations

from collections.abc import Sequence as Many
from pathlib import Path
from typing import Any

from miniloop_cli.config import Settings, load_settings
from miniloop_cli.pipeline import Registration


def register(
    folder: Path | str,
    output: Path | str | None = None,
    *,
    settings: Settings | str = "default",
    overrides: Many[str] = (),
    layout: str | None = None,
    camera: Path | str | None = None,
    max_frames: int | None = None,
    jobs: int = -1,
    seed: int = 0,
    fresh: bool = False,
    quiet: bool = True,
) -> Registration:
    """Register a recording and write its results to `output` (default `results/<name>`).

    `settings`: a Settings object, a preset's name or a YAML file; `overrides`: "key=value" on top.
    Raises MiniloopError where it cannot be done.
    """
    from miniloop_cli.artefacts import Store, default_folder
    from miniloop_cli.export.results import write_results
    from miniloop_cli.lock import exclusive
    from miniloop_cli.parallel import Workers
    from miniloop_cli.pipeline import register as run_pipeline
    from miniloop_cli.scans import open_sequence

    if not isinstance(settings, Settings):
        settings = load_settings(settings, tuple(overrides))
    sequence = open_sequence(Path(folder), layout=layout, camera_path=camera, max_frames=max_frames)
    target = Path(output) if output else Path("results") / sequence.name
    with exclusive(target):
        run = run_pipeline(sequence, settings, Store(default_folder(), fresh), Workers(jobs, quiet), seed)
        write_results(run, target)
    return run


def evaluate(trajectory: Path | str, ground_truth: Path | str) -> dict[str, Any]:
    """Errors of a trajectory file against a TUM ground truth: the JSON of `miniloop eval`."""
    from miniloop_cli.evaluation.evaluate import evaluate as run_evaluation
    from miniloop_cli.scans import read_trajectory

    return run_evaluation(read_trajectory(trajectory), read_trajectory(ground_truth)).numbers


def simulate(folder: Path | str, frames: int = 30, seed: int = 0) -> Path:
    """Write a synthetic recording with exact ground truth, in TUM's layout."""
    from miniloop_cli.scans.simulation import SimulationSettings, write_sequence

    return write_sequence(Path(folder), SimulationSettings(frames=frames), seed)
