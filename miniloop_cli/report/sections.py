"""The sections of the page; every text that came from outside goes through `escape`."""

from __future__ import annotations

import json
from collections.abc import Iterable
from html import escape
from typing import Any

import numpy as np

from miniloop_cli.errors import InputError
from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.report import charts
from miniloop_cli.report.cached_images import VIEWS_DEG, edge_picture, model_pictures
from miniloop_cli.report.images import data_uri, frame_image, jpeg
from miniloop_cli.results.assessment import Assessment, left_out, runs
from miniloop_cli.results.columns import Edges, ReportData
from miniloop_cli.results.folder import LARGEST
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.scene.sequence import Trajectory

WORST_EDGES = 10
MOST_ROWS = 5000  # of the edge table; the rest is in edges.csv
FIRST_ROWS = 25  # shown at once; page.js shows as many
MOST_THUMBNAILS = 24
COLUMNS = ("i", "j", "deg", "cm", "matches", "inliers", "verdict", "solver", "cycle")


def section(title: str, *parts: str) -> str:
    """A section with a heading; "" where there is nothing to show."""
    body = "".join(parts)
    return f'<section id="{title.partition(" ")[0].lower()}"><h2>{escape(title)}</h2>{body}</section>' if body else ""


def figure(content: str, caption: str = "", css: str = "") -> str:
    """A picture with its caption (HTML)."""
    return f'<figure class="{css}">{content}<figcaption>{caption}</figcaption></figure>'


def table(head: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """A plain table of texts."""
    top = "".join(f"<th>{escape(str(text))}</th>" for text in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(str(v))}</td>" for v in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def verdict_section(verdict: Assessment) -> str:
    """The headline, what is known, what is wrong with the recording, what to try."""
    facts = "".join(f"<li>{escape(text)}</li>" for text in verdict.facts)
    advice = "".join(f"<li>{escape(text)}</li>" for text in verdict.advice)
    tried = f"<h2>What to try</h2><ul>{advice}</ul>" if advice else ""
    causes = "".join(f"<li>{escape(f.message)}: {escape(f.advice)}</li>" for f in verdict.findings)
    wrong = f"<h2>What looks wrong with the recording</h2><ul>{causes}</ul>" if causes else ""
    head = f"<p>{escape(verdict.headline)}</p><ul>{facts}</ul>"
    return f'<section class="verdict {verdict.level}">{head}{wrong}{tried}</section>'


def trajectory_section(data: ReportData, trajectory: Trajectory | None, evaluation: Evaluation | None) -> str:
    """Top and side view, and the errors where there is a ground truth."""
    if trajectory is None:
        return section("Trajectory", "<p>There is none: no two frames could be registered.</p>")
    words = "Blue: camera positions, the ring is the first frame."
    errors = ""
    if evaluation:
        n = evaluation.numbers
        words += " Grey: ground truth."
        cm = [100 * n[f"ate_{key}_m"] for key in ("rmse", "mean", "median", "max")]
        errors = (
            f"<p>Position error {cm[0]:.2f} cm RMSE, {cm[1]:.2f} mean, {cm[2]:.2f} median, {cm[3]:.2f} at most, over "
            f"{n['poses_with_ground_truth']} poses, after {n['protocol']['alignment']} alignment on positions; ground "
            f"truth at a frame's stamp: {n['protocol']['association']}d.</p>"
        )
        keys = ("rot_deg_mean", "rot_deg_median", "trans_m_mean", "trans_m_median")
        rows = [
            (
                name,
                *(f"{(100 if 'trans' in k else 1) * rpe[k]:.2f}" for k in keys),
                rpe["pairs"],
                rpe["protocol"]["delta"],
            )
            for name, rpe in n["rpe"].items()
            if rpe["pairs"]
        ]
        errors += table(("relative error", "mean deg", "median deg", "mean cm", "median cm", "pairs", "over"), rows)
    return section("Trajectory", figure(charts.trajectory_charts(data, trajectory, evaluation), words, "pair"), errors)


def model_section(data: ReportData, trajectory: Trajectory | None, store: Store) -> str:
    """Two pictures of cloud.ply."""
    path = data.results.root / "cloud.ply"
    if trajectory is None or not path.is_file():
        return ""
    try:
        count, pictures = model_pictures(path, trajectory.T_world_cam, store)
    except InputError as error:
        return section("Model", f"<p>{escape(str(error))}</p>")
    if not pictures:
        return section("Model", "<p>cloud.ply is empty.</p>")
    shown = "".join(f'<img alt="the model" src="{data_uri(picture)}">' for picture in pictures)
    turn = " and ".join(map(str, VIEWS_DEG[1]))
    words = f"cloud.ply, {count:,} points: as the cameras looked on average, and turned by {turn} degrees."
    return section("Model", figure(shown, words, "pair"))


def overlap_section(data: ReportData) -> str:
    """Who sees the same place: the matrix and the graph."""
    edges, n = data.edges, len(data.frames)
    if not len(edges) or n < 2:
        return section("Overlap", "<p>No two frames share enough matches.</p>")
    matrix = "Below the diagonal: matches; above: inliers of verified and weak edges; red: rejected. Brighter is more."
    keys = "".join(
        f'<span class="key"><i class="k{number}"></i>{escape(charts.named(name))}: {count}</span>'
        for name, number, count in charts.cycle_counts(edges)
    )
    graph = f"Frames in order of time around the circle; verified edges, coloured by their solver.<br>{keys}"
    return section(
        "Overlap",
        '<div class="pair">',
        figure(charts.overlap_matrix(edges, n), matrix),
        figure(charts.overlap_graph(edges, n, data.frames.registered), graph),
        "</div>",
    )


def edge_rows(edges: Edges) -> list[list[Any]]:
    """Rows of the sortable table: verified, weak, rejected, each worst first; None where there is no residual."""
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


def _shown(value: Any) -> str:
    """A cell of the edge table, as page.js shows it: measured numbers with two decimals."""
    return "" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)


def edges_section(data: ReportData) -> str:
    """Residuals of all edges: a chart and a table that sorts."""
    edges = data.edges
    if not len(edges):
        return ""
    rows = edge_rows(edges)
    head = "".join(f"<th><button>{name}</button></th>" for name in COLUMNS)
    body = "".join("<tr>" + "".join(f"<td>{escape(_shown(v))}</td>" for v in r) + "</tr>" for r in rows[:FIRST_ROWS])
    # Inside a script element only "<" could end it early.
    payload = json.dumps(rows, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    more = "" if len(rows) == len(edges) else f" The {len(edges) - len(rows)} others are in edges.csv."
    words = f"How far each edge is from the final poses (deg, cm); click a heading to sort.{more}"
    return section(
        "Edges",
        figure(charts.residual_chart(edges), css="narrow"),
        f"<p>{words}</p>",
        '<p><label>Only frame <input id="only" inputmode="numeric" size="6"></label> <span id="count"></span></p>',
        f'<div class="scroll"><table id="edge-table"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>',
        '<p><button id="more">Show more</button></p>',
        f'<script type="application/json" id="edge-rows">{payload}</script>',
    )


def worst_section(data: ReportData, store: Store) -> str:
    """The worst edges with their inlier matches drawn on the images."""
    edges, parts = data.edges, []
    if data.sequence is None or not len(data.frames):
        return ""
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
        parts.append(figure(f'<img alt="frames {i} and {j}" src="{data_uri(picture)}">', escape(words)))
    return section("Worst edges", '<div class="pair">', *parts, "</div>") if parts else ""


def frames_section(data: ReportData) -> str:
    """Statistics per frame, and the frames without a pose: why, and what they look like."""
    frames = data.frames
    missing = np.flatnonzero(~frames.registered)
    rows = [(reason, len(numbers), runs(numbers, most=100)) for reason, numbers in left_out(data)]
    lost = table(("why there is no pose", "frames", "which"), rows[:50]) if rows else ""
    thumbnails = []
    for k in missing[:: max(1, -(-len(missing) // MOST_THUMBNAILS))] if data.sequence else []:
        found = frame_image(data.sequence, int(k), 200)
        if found:
            thumbnails.append(figure(f'<img alt="frame {k}" src="{data_uri(jpeg(found[0]))}">', f"{k}"))
    strip = f'<div class="strip">{"".join(thumbnails)}</div>' if thumbnails else ""
    shown = charts.frame_charts(frames)
    words = "Green line: features with depth." + (" Red: frames without a pose." if len(missing) else "")
    return section("Frames", figure(shown, words, "pair") if shown else "", lost, strip)


def run_section(data: ReportData) -> str:
    """Timings, settings, versions, log."""
    summary = data.summary
    timings = summary.get("timings_s")
    items = timings.items() if isinstance(timings, dict) else ()
    timings = {k: v for k, v in items if isinstance(v, (int, float)) and 0 <= v < LARGEST}
    longest = max(timings.values(), default=0) or 1
    bars = "".join(
        f"<tr><td>{escape(str(name))}</td><td>{seconds:.2f} s</td>"
        f'<td class="bar"><i style="width:{100 * seconds / longest:.0f}%"></i></td></tr>'
        for name, seconds in timings.items()
    )
    times = f'<h3>Timings</h3><table class="times">{bars}</table>' if bars else ""
    versions = summary.get("versions")
    known = table(("package", "version"), versions.items()) if isinstance(versions, dict) else ""
    rest = {k: v for k, v in summary.items() if k not in ("timings_s", "versions")}
    facts = table(
        ("summary.json", ""), [(k, json.dumps(v) if isinstance(v, (dict, list)) else v) for k, v in rest.items()]
    )
    camera = ""
    if data.sequence:
        c = data.sequence.camera
        camera = (
            f"<h3>Camera</h3><p>fx {c.fx:.3f}, fy {c.fy:.3f}, cx {c.cx:.3f}, cy {c.cy:.3f}, {c.width} x {c.height}, "
        )
        camera += f"{c.depth_scale:g} units a metre; {escape(c.source)}</p>"
        camera += "".join(f"<p>{escape(note)}</p>" for note in data.sequence.notes)
    texts = [(name, data.text(name)) for name in ("config.yaml", "log.txt")]
    folded = "".join(f"<details><summary>{n}</summary><pre>{escape(t)}</pre></details>" for n, t in texts if t)
    return section("Run", times, camera, "<h3>Summary</h3>" if rest else "", facts if rest else "", known, folded)
