"""`write_report`: one self-contained HTML page of a results folder."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.datasets import read_ground_truth
from miniloop_cli.errors import MiniloopError
from miniloop_cli.evaluation.evaluate import Evaluation, evaluate
from miniloop_cli.report import sections
from miniloop_cli.results.assessment import Level, judge
from miniloop_cli.results.columns import ReportData
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.version import __version__

if TYPE_CHECKING:
    from miniloop_cli.inspection.findings import Finding

# The page may use what it carries and nothing else, so that it shows the same everywhere and tells nobody.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def write_report(data: ReportData, store: Store) -> Path:
    """Write `report.html` into the results folder that `data` was read from, and return its path.

    A sequence in `data` adds images of the frames and, where the recording has one, the ground truth. Files that are
    missing from the folder leave their sections out; a run without any pose still gets its verdict. Pictures are kept
    in `store`. Raises InputError for files that are malformed.
    """
    trajectory = data.results.trajectory if (data.results.root / "trajectory.txt").is_file() else None
    evaluation = against_truth(data, trajectory)
    verdict = judge(data, evaluation)
    if verdict.level != Level.GOOD:
        verdict = replace(verdict, findings=causes(data))
    body = [
        sections.verdict_section(verdict),
        sections.trajectory_section(data, trajectory, evaluation),
        sections.model_section(data, trajectory, store),
        sections.overlap_section(data),
        sections.edges_section(data),
        sections.worst_section(data, store),
        sections.frames_section(data),
        sections.run_section(data),
    ]
    path = data.results.root / "report.html"
    with atomic_write(path) as file:
        file.write(page(data.name, "\n".join(body)))
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


def causes(data: ReportData) -> tuple[Finding, ...]:
    """What `miniloop inspect` finds wrong with the recording, with the camera of this run; nothing without it."""
    if data.sequence is None:
        return ()
    from miniloop_cli.inspection.inspect import inspect

    seed = data.summary.get("seed")
    rng = np.random.default_rng(seed if isinstance(seed, int) and seed >= 0 else 0)
    try:
        found = inspect(data.sequence, rng).findings
    except MiniloopError:
        return ()
    return tuple(finding for finding in found if finding.level != "note")


def page(name: str, body: str) -> str:
    """The whole document."""
    assets = files("miniloop_cli.report")
    style, script = (assets.joinpath(asset).read_text(encoding="utf-8") for asset in ("page.css", "page.js"))
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<title>{escape(name)} – miniloop</title>
<style>
{style}</style>
</head>
<body>
<header><h1>{escape(name)}</h1><p>miniloop {escape(__version__)}</p></header>
<main>
{body}
</main>
<script>
{script}</script>
</body>
</html>
"""
