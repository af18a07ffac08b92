"""`write_report`: one self-contained HTML page of a results folder."""

from __future__ import annotations

from pathlib import Path

from miniloop_cli.report import sections
from miniloop_cli.report.assessment import assess
from miniloop_cli.report.templating import asset, render
from miniloop_cli.report.truth import against_truth
from miniloop_cli.report.viewer.embedded import embedded
from miniloop_cli.results.columns import ReportData
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.version import __version__


def write_report(data: ReportData, store: Store) -> Path:
    """Write `report.html` into the results folder that `data` was read from, and return its path.

    A sequence in `data` adds images of the frames and, if there is one, the ground truth. Sections of missing files are
    left out; a run without poses still gets its verdict. Pictures are cached in `store`. Raises InputError for
    malformed files.
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
