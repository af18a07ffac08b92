"""The same graph solved in pairs and in cycles: errors of the edges before averaging and after, and what it costs."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from miniloop_cli.bench import Row
from miniloop_cli.bench.known_overlaps import Overlaps, read_overlaps, right
from miniloop_cli.config import Settings
from miniloop_cli.geometry import se3
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import VERIFIED, Edge
from miniloop_cli.scene.poses import Poses
from miniloop_cli.stages.average import average
from miniloop_cli.stages.solve_edges import solve_edges
from miniloop_cli.typing import Floats, Pair
from miniloop_cli.verification.photometric_check import PhotometricCheck
from miniloop_cli.verification.repetition import steps_m

LENGTHS = (2, 3, 4, 5, 6, 7)
NAMES = {2: "pairs only", **{n: f"up to {n}-cycles" for n in LENGTHS[1:]}}
REPEATS = 3


def edge_rows(
    sequences: Sequence[Path], longest: Sequence[int], max_frames: int | None, seed: int, workers: Workers
) -> Iterator[Row]:
    """A row a recording and longest cycle, pairs first; the errors of all rows of a recording are over the same edges.

    "before": edges as they were estimated, those that every row verified; "after": the same edges between the
    averaged poses. `cpu_s`: of solving the edges, user and system time of all threads, the least of a few runs.
    """
    lengths = sorted({2, *longest})
    for folder in sequences:
        settings = {n: load_settings(overrides=(f"cycles.longest={n}",)) for n in lengths}
        overlaps = read_overlaps(folder, settings[2], max_frames, workers)
        _warm_up(overlaps, settings.values(), seed, workers)
        features = [scan.features for scan in overlaps.scans]
        steps = steps_m(features, overlaps.points, overlaps.camera.width, settings[2], workers)
        views, outline = [scan.view for scan in overlaps.scans], [found.outline for found in features]
        photometric = PhotometricCheck(views, overlaps.points, outline, steps, overlaps.camera)
        solved, poses, seconds = {}, {}, {}
        for n in lengths:
            solved[n], seconds[n] = _solve(overlaps, settings[n], seed, workers)
            poses[n], _ = average(solved[n], len(overlaps.points), settings[n].averaging, photometric)
        pairs = sorted(set.intersection(*(_scored(solved[n], poses[n], overlaps) for n in lengths)))
        for n in lengths:
            row: Row = {"sequence": overlaps.name, "edges_are": NAMES[n], "longest": n, "edges": len(overlaps.matches)}
            row |= _verdicts(solved[n], overlaps) | {"scored": len(pairs)}
            row |= _errors("before", overlaps, pairs, _estimated(solved[n], pairs))
            row |= _errors("after", overlaps, pairs, _averaged(poses[n], pairs))
            row |= {"cpu_s": round(seconds[n], 3), "cpu_over_pairs": round(seconds[n] / seconds[2], 3)}
            yield row


def _solve(overlaps: Overlaps, settings: Settings, seed: int, workers: Workers) -> tuple[list[Edge], float]:
    least, edges = np.inf, []
    for _ in range(REPEATS):
        begin = time.process_time()
        edges = solve_edges(overlaps.matches, overlaps.points, settings, seed, workers)
        least = min(least, time.process_time() - begin)
    return edges, least


def _warm_up(overlaps: Overlaps, settings: Iterable[Settings], seed: int, workers: Workers) -> None:
    """Compile, or load what is compiled, on the first scans."""
    few = {pair: rows for pair, rows in overlaps.matches.items() if max(pair) < 12}
    for one in settings:
        solve_edges(few, overlaps.points, one, seed, replace(workers, quiet=True))


def _verdicts(edges: Sequence[Edge], overlaps: Overlaps) -> Row:
    """How many edges are verified, and how many of these are mistakes."""
    found = [e for e in edges if e.verdict == VERIFIED and overlaps.known[e.i] and overlaps.known[e.j]]
    errors = overlaps.errors([(e.i, e.j) for e in found], np.array([e.T_j_i for e in found]))
    return {"verified": len(found), "wrong": int((~right(*errors)).sum())}


def _scored(edges: Sequence[Edge], poses: Poses, overlaps: Overlaps) -> set[Pair]:
    usable = overlaps.known & (poses.component == 0)
    return {(e.i, e.j) for e in edges if e.verdict == VERIFIED and usable[e.i] and usable[e.j]}


def _estimated(edges: Sequence[Edge], pairs: Sequence[Pair]) -> Floats:
    T_j_i = {(e.i, e.j): e.T_j_i for e in edges}
    return np.array([T_j_i[pair] for pair in pairs]).reshape(-1, 4, 4)


def _averaged(poses: Poses, pairs: Sequence[Pair]) -> Floats:
    i, j = np.array(pairs, np.int64).reshape(-1, 2).T
    return se3.inverse(poses.T_world_cam[j]) @ poses.T_world_cam[i]


def _errors(when: str, overlaps: Overlaps, pairs: Sequence[Pair], T_j_i: Floats) -> Row:
    """Mean, median and 95th percentile of rotation (degrees) and translation error (cm)."""
    deg, metres = overlaps.errors(pairs, T_j_i)
    row: Row = {}
    for name, errors in (("deg", deg), ("cm", 100 * metres)):
        for kind, of in (("mean", np.mean), ("median", np.median), ("p95", lambda x: np.percentile(x, 95))):
            row[f"{when}_{name}_{kind}"] = round(float(of(errors)), 6) if len(errors) else None
    return row


def draw_edges(rows: Sequence[Row]) -> Figure:
    """Errors over those of pairs only, in percent: a panel a recording, a line a measure, by the longest cycle."""
    sequences = list(dict.fromkeys(row["sequence"] for row in rows))
    figure = Figure(figsize=(4.6 * max(len(sequences), 1) + 2.2, 4), layout="constrained")
    panels = figure.subplots(1, max(len(sequences), 1), sharey=True, squeeze=False)[0]
    for axes, sequence in zip(panels, sequences, strict=False):
        mine = [row for row in rows if row["sequence"] == sequence]
        for place, (when, style) in enumerate((("before", "-"), ("after", "--"))):
            for k, kind in enumerate(("mean", "median", "p95")):
                for name, marker in (("deg", "o"), ("cm", "s")):
                    key = f"{when}_{name}_{kind}"
                    if place == 1 and kind != "mean":
                        continue
                    values = [100 * row[key] / mine[0][key] for row in mine if row[key] is not None]
                    label = f"{name}, {kind}, {when} averaging"
                    axes.plot(range(len(values)), values, marker + style, color=f"C{k}", label=label, markersize=5)
        axes.set_xticks(range(len(mine)), [row["edges_are"] for row in mine], rotation=20)
        axes.set(title=sequence, ylabel="error [% of pairs only]" if axes is panels[0] else None)
        axes.grid(alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    return figure
