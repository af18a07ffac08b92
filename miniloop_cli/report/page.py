"""`write_report`: one self-contained HTML page of a results folder."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from miniloop_cli.report import sections
from miniloop_cli.report.assessment import assess
from miniloop_cli.report.templating import asset, render
from miniloop_cli.report.truth import against_truth
from miniloop_cli.report.viewer.embedded import embedded
from miniloop_cli.results.columns import ReportData
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.version import __version__

ONE = Workers(1)


def write_report(data: ReportData, store: Store, workers: Workers = ONE) -> Path:
    """Write `report.html` into the results folder that `data` was read from, and return its path.

    A sequence in `data` adds images of the frames and, if there is one, the ground truth. Sections of missing files are
    left out; a run without poses still gets its verdict. Pictures are cached in `store`. Raises InputError for
    malformed files.
    """
    trajectory = data.results.trajectory if (data.results.root / "trajectory.txt").is_file() else None
    evaluation = against_truth(data, trajectory)
    # Sections that read images come first, as they take longest.
    parts: dict[str, Callable[[], Any]] = {
        "view": partial(embedded, data, evaluation, store),
        "worst_edges": partial(sections.worst_edges, data, store),
        "model": partial(sections.model, data, trajectory, store),
        "trajectory": partial(sections.trajectory, data, trajectory, evaluation),
        "overlap": partial(sections.overlap, data),
        "edges": partial(sections.edges, data),
        "frames": partial(sections.frames, data),
        "run": partial(sections.run, data),
        "assessment": partial(assess, data, evaluation),
    }
    made = workers.map(lambda part: part(), parts.values(), "writing the report", len(parts))
    page = render(
        "page.html",
        name=data.name,
        version=__version__,
        style=asset("page.css") + asset("viewer/assets/viewer.css"),
        script=asset("page.js"),
        viewer=asset("viewer/assets/viewer.js"),
        **dict(zip(parts, made, strict=True)),
    )
    path = data.results.root / "report.html"
    with atomic_write(path) as file:
        file.write(page)
    return path
