"""The page of a comparison: its table, and both results in one 3D view."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.report.templating import asset, render
from miniloop_cli.report.viewer.embedded import embedded
from miniloop_cli.report.viewer.scene import rounded
from miniloop_cli.results.columns import Edges, ReportData
from miniloop_cli.results.comparison import SCALE_OFF, Comparison, Side
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.interpolation import nearest
from miniloop_cli.version import __version__

Row = tuple[str, str, str]


def rows(found: Comparison) -> list[Row]:
    """The table: quantity, first, second."""
    errors: list[tuple[str, str]] = []
    if any(found.errors):
        errors = [("position error, RMSE", "ate_rmse_m"), ("position error, largest", "ate_max_m")]
    a, b = found.first, found.second
    only = found.only if a.run and b.run else None
    table: list[Row] = [
        ("poses", str(len(a.trajectory.timestamps_s)), str(len(b.trajectory.timestamps_s))),
        *((f"{name} edges", _edges(a, name), _edges(b, name)) for name in ("verified", "weak", "rejected")),
        ("verified edges that only it has", str(len(only[0])) if only else "", str(len(only[1])) if only else ""),
        ("seconds", _seconds(a), _seconds(b)),
        *((words, _error_cm(found.errors[0], key), _error_cm(found.errors[1], key)) for words, key in errors),
    ]
    return [row for row in table if row[1] or row[2]]


def differences(found: Comparison) -> list[str]:
    """Sentences: by how much the two differ, and where most."""
    cm, deg = 100 * found.distances_m, found.angles_deg
    rmse = float(np.sqrt((cm**2).mean()))
    said = [
        f"{len(cm)} poses are compared, after {found.laid.numbers['protocol']['alignment']} alignment on positions.",
        f"Positions differ by {rmse:.2f} cm RMSE, {np.median(cm):.2f} cm at the median, {cm.max():.2f} cm at most; "
        f"rotations by {np.median(deg):.2f} deg at the median, {deg.max():.2f} deg at most.",
        f"They differ most at frame{'' if found.farthest.isdigit() else 's'} {found.farthest}.",
    ]
    if abs(found.scale - 1) > SCALE_OFF and found.laid.numbers["protocol"]["alignment"] == "SE3":
        said.append(f"The second is {found.scale:.3f} times as large as the first: --scale takes that out.")
    if found.second.trajectory.source:
        said.append(f"{found.second.name} was read as {found.second.trajectory.source}.")
    return said


def _edges(side: Side, verdict: str) -> str:
    if side.run is None:
        return ""
    return str(sum((text or "verified") == verdict for text in side.run.edges.verdict))


def _error_cm(error: Evaluation | None, key: str) -> str:
    return f"{100 * error.numbers[key]:.2f} cm" if error else ""


def _seconds(side: Side) -> str:
    timings = side.run.summary.get("timings_s") if side.run else None
    if not isinstance(timings, dict):
        return ""
    return f"{sum(value for value in timings.values() if isinstance(value, int | float)):.1f}"


def write_comparison(found: Comparison, shown: ReportData, path: Path, store: Store) -> Path:
    """Write the page. `shown`: the first result, with its recording, if available."""
    view = embedded(shown, found.errors[0], store)
    if view is not None:
        _add_second(view["scene"], found)
    page = render(
        "compare.html",
        first=found.first.name,
        second=found.second.name,
        version=__version__,
        style=asset("page.css") + asset("viewer/assets/viewer.css"),
        viewer=asset("viewer/assets/viewer.js"),
        rows=rows(found),
        differences=differences(found),
        settings=[(key, str(a), str(b)) for key, a, b in found.settings],
        view=view,
    )
    with atomic_write(path) as file:
        file.write(page)
    return path


def _add_second(scene: dict[str, Any], found: Comparison) -> None:
    """The second's path, its distance by frame, and its edges, added to the scene of the first."""
    count = len(scene["frames"]["pose"])
    positions: list[list[float] | None] = [None] * count
    apart = np.full(count, np.nan)
    # The first is the ground truth in `laid`; its world is that of its trajectory, which was not moved.
    for k, T, distance_m in zip(found.frames.tolist(), found.laid.T_aligned, found.distances_m, strict=True):
        positions[k], apart[k] = rounded(T[:3, 3], 5), distance_m
    scene["other"] = {"name": found.second.name, "positions": positions}
    scene["frames"]["difference_m"] = rounded(apart, 6)
    if found.second.run is not None:
        _add_edges(scene["edges"], found, found.second.run)


def _add_edges(edges: dict[str, Any], found: Comparison, second: ReportData) -> None:
    """Mark each edge of the first by who has it, and add those that only the second has."""
    first_only, second_only = found.only
    edges["origins"] = ["both, or not verified", f"only {found.first.name}", f"only {found.second.name}"]
    pairs = zip(edges["i"], edges["j"], strict=True)
    verified = [edges["verdicts"][number] == "verified" for number in edges["verdict"]]
    edges["origin"] = [int(own and pair in first_only) for pair, own in zip(pairs, verified, strict=True)]
    held = set(zip(edges["i"], edges["j"], strict=True))
    by_pair = _by_pair(found, second.edges)
    number = edges["verdicts"].index("verified")
    for i, j in sorted(second_only):
        row = by_pair[i, j]
        if (i, j) in held:  # the first has it as well, but not verified
            edges["origin"][list(zip(edges["i"], edges["j"], strict=True)).index((i, j))] = 2
            continue
        solver = second.edges.solver[row]
        if solver not in edges["solvers"]:
            edges["solvers"].append(solver)
            edges["solver_words"].append(solver)
        added = {
            "i": i,
            "j": j,
            "solver": edges["solvers"].index(solver),
            "verdict": number,
            "rejection": "",
            "reason": "",
            "cycle": "",
            "matches": rounded(second.edges.matches[[row]], 0)[0],
            "inliers": rounded(second.edges.inliers[[row]], 0)[0],
            "deg": rounded(second.edges.rot_deg[[row]], 3)[0],
            "m": rounded(second.edges.trans_m[[row]], 5)[0],
            "drawn": 0,
            "origin": 2,
        }
        for key, value in added.items():
            edges[key].append(value)


def _by_pair(found: Comparison, edges: Edges) -> dict[tuple[int, int], int]:
    """Rows of the second's edges by the first's frame numbers."""
    if found.first.run is None or found.second.run is None:
        return {}
    number = nearest(found.first.run.frames.timestamp_s, found.second.run.frames.timestamp_s)
    pairs = zip(number[edges.i].tolist(), number[edges.j].tolist(), strict=True)
    return {pair: row for row, pair in enumerate(pairs)}
