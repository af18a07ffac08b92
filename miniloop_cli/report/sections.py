"""The content of each section of the page, as plain values for the template of its name; None if it is empty."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from miniloop_cli.errors import InputError
from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.report import charts
from miniloop_cli.report.cached_images import VIEWS_DEG, edge_picture, model_pictures
from miniloop_cli.report.images import data_uri, frame_image, jpeg
from miniloop_cli.results import calibration
from miniloop_cli.results.columns import Edges, ReportData
from miniloop_cli.results.facts import left_out, runs
from miniloop_cli.results.folder import LARGEST
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.scene.sequence import Trajectory

WORST_EDGES = 10
MOST_ROWS = 5000  # of the edge table; the rest is in edges.csv
FIRST_ROWS = 25  # shown at once; page.js shows as many
MOST_THUMBNAILS = 24
MOST_REASONS = 50
COLUMNS = ("i", "j", "deg", "cm", "matches", "inliers", "verdict", "solver", "cycle")

Section = dict[str, Any]  # values by the names that the template calls them


def trajectory(data: ReportData, trajectory: Trajectory | None, evaluation: Evaluation | None) -> Section:
    """Top and side view, and the errors if there is a ground truth."""
    shown = [] if trajectory is None else charts.trajectory_charts(data, trajectory, evaluation)
    return {"charts": shown, "errors": evaluation.numbers if evaluation else None}


def model(data: ReportData, trajectory: Trajectory | None, store: Store) -> Section | None:
    """Two pictures of cloud.ply."""
    path = data.results.root / "cloud.ply"
    if trajectory is None or not path.is_file():
        return None
    try:
        points, pictures = model_pictures(path, trajectory.T_world_cam, store)
    except InputError as error:
        return {"problem": str(error)}
    if not pictures:
        return {"problem": "cloud.ply has no points."}
    shown = [data_uri(picture) for picture in pictures]
    return {"problem": "", "points": points, "pictures": shown, "turned_deg": VIEWS_DEG[1]}


def overlap(data: ReportData) -> Section:
    """The overlap of frames: the matrix and the graph."""
    edges, n = data.edges, len(data.frames)
    if not len(edges) or n < 2:
        return {"matrix": None}
    return {
        "matrix": charts.overlap_matrix(edges, n),
        "graph": charts.overlap_graph(edges, n, data.frames.registered),
        "solvers": [(charts.named(name), number, count) for name, number, count in charts.cycle_counts(edges)],
    }


def edges(data: ReportData) -> Section | None:
    """Residuals of all edges: a chart and a table that sorts."""
    if not len(data.edges):
        return None
    rows = edge_rows(data.edges)
    return {
        "chart": charts.residual_chart(data.edges),
        "columns": COLUMNS,
        "rows": rows,
        "first_rows": rows[:FIRST_ROWS],
        "left_out": len(data.edges) - len(rows),
    }


def edge_rows(edges: Edges) -> list[list[Any]]:
    """Rows of the sortable table: verified, weak, rejected, each worst first; None without a residual."""
    order = edges.by_residual
    rank = np.where(edges.verified, 0, np.where(edges.rejected, 2, 1))[order]
    rows = []
    for k in order[np.argsort(rank, kind="stable")][:MOST_ROWS]:
        verdict = f"{edges.verdict[k]}: {edges.reason[k]}" if edges.reason[k] else edges.verdict[k]
        counts = [int(v) if np.isfinite(v) else None for v in (edges.matches[k], edges.inliers[k])]
        residuals = [round(float(v), 3) if np.isfinite(v) else None for v in (edges.rot_deg[k], 100 * edges.trans_m[k])]
        cycle = None if edges.cycle[k] in ("", "-1") else edges.cycle[k]
        solver = charts.named(edges.solver[k])
        rows.append([int(edges.i[k]), int(edges.j[k]), *residuals, *counts, verdict, solver, cycle])
    return rows


def worst_edges(data: ReportData, store: Store) -> list[Section]:
    """The worst edges with their inlier matches drawn on the images, one entry an edge."""
    edges, shown = data.edges, []
    if data.sequence is None or not len(data.frames):
        return []
    for k in edges.worst_first[:WORST_EDGES]:
        i, j = int(edges.i[k]), int(edges.j[k])
        nothing = np.empty((0, 2))
        picture = edge_picture(data.sequence, i, j, *data.inlier_px.get(int(k), (nothing, nothing)), store)
        if picture is None:
            continue
        words = (
            f"{i}–{j}: {edges.rot_deg[k]:.2f} deg, {100 * edges.trans_m[k]:.1f} cm; {edges.inliers[k]:.0f} of "
            f"{edges.matches[k]:.0f} matches agree; {edges.verdict[k]}, solved as {charts.named(edges.solver[k])}"
        )
        shown.append({"i": i, "j": j, "words": words, "picture": data_uri(picture)})
    return shown


def frames(data: ReportData) -> Section | None:
    """Statistics per frame, and the frames without a pose, with reasons and images."""
    missing = np.flatnonzero(~data.frames.registered).tolist()
    rows = [(reason, len(numbers), runs(numbers, most=100)) for reason, numbers in left_out(data.columns)]
    thumbnails = []
    if data.sequence is not None:
        for k in missing[:: max(1, -(-len(missing) // MOST_THUMBNAILS))]:
            found = frame_image(data.sequence, k, 200)
            if found:
                thumbnails.append((k, data_uri(jpeg(found[0]))))
    shown = charts.frame_charts(data.frames)
    if not (shown or rows):
        return None
    return {"charts": shown, "missing": rows[:MOST_REASONS], "thumbnails": thumbnails}


def _calibration(found: Any) -> Section:
    """The estimated camera of the run; empty without calibration, or if the file is damaged."""
    try:
        return {"calibration": calibration.rows(found), "calibration_words": calibration.in_words(found)}
    except (TypeError, KeyError, ValueError, AttributeError):
        return {"calibration": [], "calibration_words": ""}


def run(data: ReportData) -> Section | None:
    """Timings, settings, versions, log."""
    summary = data.summary
    timings, versions = (found if isinstance(found := summary.get(k), dict) else {} for k in ("timings_s", "versions"))
    timings = {k: v for k, v in timings.items() if isinstance(v, int | float) and 0 <= v < LARGEST}
    longest = max(timings.values(), default=0) or 1
    shown = {
        "timings": [(name, seconds, round(100 * seconds / longest)) for name, seconds in timings.items()],
        "recording": data.sequence,
        **_calibration(summary.get("calibration")),
        "summary": [
            (name, json.dumps(value) if isinstance(value, dict | list) else value)
            for name, value in summary.items()
            if name not in ("timings_s", "versions", "calibration")
        ],
        "versions": list(versions.items()),
        "texts": [(name, text) for name in ("config.yaml", "log.txt") if (text := data.text(name))],
    }
    return shown if any(shown.values()) else None
