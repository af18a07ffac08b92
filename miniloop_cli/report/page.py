"""`write_report`: one self-contained HTML page of a results folder."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from miniloop_cli.datasets import read_ground_truth
from miniloop_cli.errors import MiniloopError
from miniloop_cli.evaluation.evaluate import Evaluation, evaluate
from miniloop_cli.report import sections
from miniloop_cli.report.assessment import assess
from miniloop_cli.report.templating import render
from miniloop_cli.report.viewer.embedded import embedded
from miniloop_cli.results.columns import ReportData
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.version import __version__


def write_report(data: ReportData, store: Store) -> Path:
    """Write `report.html` into the results folder that `data` was read from, and return its path.

    A sequence in `data` adds images of the frames and, where the recording has one, the ground truth. Files that are
    missing from the folder leave their sections out; a run without any pose still gets its verdict. Pictures are kept
    in `store`. Raises InputError for files that are malformed.
    """
    trajectory = data.results.trajectory if (data.results.root / "trajectory.txt").is_file() else None
    evaluation = against_truth(data, trajectory)
    page = render(
        "page.html",
        name=data.name,
        version=__version__,
        style=asset("page.css") + asset("viewer/assets/viewer.css"),
        script=asset("page.js"),
        viewer=asset("viewer/assets/viewer.js"),
        assessment=assess(data, evaluation),
        view=embedded(data, evaluation, store),
        trajectory=sections.trajectory(data, trajectory, evaluation),
        model=sections.model(data, trajectory, store),
        overlap=sections.overlap(data),
        edges=sections.edges(data),
        worst_edges=sections.worst_edges(data, store),
        frames=sections.frames(data),
        run=sections.run(data),
    )
    path = data.results.root / "report.html"
    with atomic_write(path) as file:
        file.write(page)
    return path


def against_truth(data: ReportData, trajectory: Trajectory | None) -> Evaluation | None:
    """The evaluation, where the recording has a ground truth that fits; a bad ground truth does not spoil a report."""
    if trajectory is None or data.sequence is None:
        return None
    try:
        truth = read_ground_truth(data.sequence)
        return evaluate(trajectory, truth, data.results.edge_stamps_s) if truth else None
    except MiniloopError:
        return None


def asset(name: str) -> str:
    """The text of a file of this package."""
    return files("miniloop_cli.report").joinpath(name).read_text(encoding="utf-8")
