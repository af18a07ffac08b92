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
from miniloop_cli.config import Estimation
from miniloop_cli.geometry import se3
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses
from miniloop_cli.stages.average import average, photometric_check
from miniloop_cli.stages.run import Run
from miniloop_cli.stages.solve_edges import solve_cycles
from miniloop_cli.typing import Bools, Floats, Ints

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
        _warm_up(overlaps, [each.estimation for each in settings.values()], seed, workers)
        (ransac, verification, _), run = settings[2].estimation, Run(Store(default_folder()), workers, seed)
        photometric = photometric_check(overlaps.scans, ransac, verification.chi2, run)
        solved, poses, seconds = {}, {}, {}
        for n in lengths:
            solved[n], seconds[n] = _solve(overlaps, settings[n].estimation, seed, workers)
            poses[n], _ = average(solved[n], overlaps.scans, settings[n].averaging, photometric, run)
        # Every row has all edges of the graph, in the same order.
        scored = np.all([_scored(solved[n], poses[n], overlaps) for n in lengths], axis=0)
        pairs = solved[2].pairs[scored]
        for n in lengths:
            row: Row = {"sequence": overlaps.name, "edges_are": NAMES[n], "longest": n, "edges": len(overlaps.matches)}
            row |= _verdicts(solved[n], overlaps) | {"scored": len(pairs)}
            row |= _errors("before", overlaps, pairs, solved[n].T_j_i[scored])
            row |= _errors("after", overlaps, pairs, _averaged(poses[n], pairs))
            row |= {"cpu_s": round(seconds[n], 3), "cpu_over_pairs": round(seconds[n] / seconds[2], 3)}
            yield row


def _solve(overlaps: Overlaps, settings: Estimation, seed: int, workers: Workers) -> tuple[EdgeTable, float]:
    seconds = []
    for _ in range(REPEATS):
        begin = time.process_time()
        edges = solve_cycles(overlaps.matches, overlaps.points, settings, seed, workers)
        seconds.append(time.process_time() - begin)
    return edges, min(seconds)


def _warm_up(overlaps: Overlaps, settings: Iterable[Estimation], seed: int, workers: Workers) -> None:
    """Compile, or load what is compiled, on the first scans."""
    few = {pair: rows for pair, rows in overlaps.matches.items() if max(pair) < 12}
    for one in settings:
        solve_cycles(few, overlaps.points, one, seed, replace(workers, quiet=True))


def _verdicts(edges: EdgeTable, overlaps: Overlaps) -> Row:
    """How many edges are verified, and how many of these are mistakes."""
    found = edges.subset(_measured(edges, overlaps))
    errors = overlaps.errors(found.pairs, found.T_j_i)
    return {"verified": len(found), "wrong": int((~right(*errors)).sum())}


def _measured(edges: EdgeTable, overlaps: Overlaps) -> Bools:
    """(m,) whether an edge is verified and its true relative pose is known."""
    return edges.verified & overlaps.known[edges.i] & overlaps.known[edges.j]


def _scored(edges: EdgeTable, poses: Poses, overlaps: Overlaps) -> Bools:
    """(m,) whether an edge can also be measured after averaging."""
    return _measured(edges, overlaps) & poses.joins(edges)


def _averaged(poses: Poses, pairs: Ints) -> Floats:
    i, j = pairs.T
    return se3.inverse(poses.T_world_cam[j]) @ poses.T_world_cam[i]


def _errors(when: str, overlaps: Overlaps, pairs: Ints, T_j_i: Floats) -> Row:
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
