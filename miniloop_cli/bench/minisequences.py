"""Pairs and cycles on loops of five scans of a real recording, as in the paper (section 5.2, table of real errors)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from miniloop_cli.bench import Row
from miniloop_cli.bench.noise import METHODS, PAPER, chained, edges_of
from miniloop_cli.bench.overlaps import Overlaps, overlaps
from miniloop_cli.geometry import se3
from miniloop_cli.presets import load_settings
from miniloop_cli.ransac.matches import edge_matches
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.points import Matches
from miniloop_cli.scene.registration import RegistrationError
from miniloop_cli.typing import Bools, Floats

Loop = tuple[int, ...]
Errors = dict[tuple[str, str], tuple[float, float]]  # by method and variant

SCANS = 5
# All pairs that a method uses: the chain 1-2-3-4-5 and the closing edges of its cycles.
NEEDED = sorted({edge for segments in METHODS.values() for segment in segments for edge in edges_of(segment)})
PAPER_REAL = PAPER.model_copy(update={"threshold_m": 0.10, "iterations": 2000})
VARIANTS = {
    "paper": PAPER_REAL,
    "refined": PAPER_REAL.model_copy(update={"score": "msac", "local_optimization": True}),
}
EQUAL_DEG, EQUAL_CM = 1e-4, 1e-4  # "equal" in the paper: within 1e-4 deg, 1e-3 mm
PAPER_NUMBERS = {  # deg, cm; shares better than pairwise (rotation, translation), shares equal to it
    "pairwise": (0.90, 2.53, None, None, None, None),
    "3-cycle": (0.80, 2.44, 0.53, 0.48, 0.30, 0.32),
    "4-,2-cycle": (0.80, 2.47, 0.46, 0.36, 0.36, 0.39),
    "5-cycle": (0.77, 2.60, 0.63, 0.46, 0.08, 0.09),
}
COLUMNS = ("rot_deg_mean", "trans_cm_mean", "rot_better", "trans_better", "rot_equal", "trans_equal")
TRIES = 1000  # random walks for each loop; a graph without success has too few loops


def draw_loops(matches: Matches, known: Bools, count: int, rng: np.random.Generator) -> list[Loop]:
    """`count` different sequences of five scans in order of time, with matches between all pairs that are NEEDED.

    `matches` are the edges, `known` (n,) the scans with ground truth. Fewer if the graph has no more.
    Raises RegistrationError if it has none.
    """
    later: dict[int, set[int]] = {}
    for i, j in matches:
        if known[i] and known[j]:
            later.setdefault(i, set()).add(j)
    before = [[a for a, b in NEEDED if b == place] for place in range(SCANS)]
    starts, found = sorted(later), dict[Loop, None]()
    for _ in range(TRIES * count if starts else 0):
        loop = [int(rng.choice(starts))]
        while len(loop) < SCANS:
            seen_by_all = set.intersection(*(later.get(loop[k], set()) for k in before[len(loop)]))
            free = sorted(scan for scan in seen_by_all if scan > loop[-1])
            if not free:
                break
            loop.append(int(rng.choice(free)))
        else:
            found[tuple(loop)] = None
            if len(found) == count:
                break
    if not found:
        raise RegistrationError("no five scans of this recording overlap in a loop; lower --min-matches")
    return list(found)


def minisequence_rows(
    sequences: Iterable[Path],
    configs: Iterable[str],
    loops: int,
    min_matches: int | None,
    seed: int,
    workers: Workers,
) -> Iterator[Row]:
    """Rows a recording, config, variant and method: mean errors of the motion from scan 1 to scan 5.

    `configs`: settings of features and matching; `min_matches` of an edge (default: gives the paper's share of the
    pairs). Rows also have the shares of errors less than pairwise, and equal to it. Each loop has its own generator, so
    rows do not depend on the number of jobs.
    """
    named = {config: load_settings(config) for config in configs}
    for folder in sequences:
        for config, settings in named.items():
            yield from _rows(overlaps(folder, settings, workers), config, loops, min_matches, seed, workers)


def _rows(graph: Overlaps, config: str, loops: int, least: int | None, seed: int, workers: Workers) -> list[Row]:
    least = least or graph.least_as_in_paper
    edges = graph.with_matches(least)
    chosen = draw_loops(edges, graph.true_poses[1], loops, np.random.default_rng(seed))

    def errors(loop: Loop) -> Errors:
        return _errors(loop, graph, edges, seed)

    found = list(workers.map(errors, chosen, "Loops of five", len(chosen)))
    rows = []
    for variant in VARIANTS:
        for method in METHODS:
            both = [r for r in found if (method, variant) in r and ("pairwise", variant) in r]
            mine, pairs = (np.array([r[name, variant] for r in both]).reshape(-1, 2) for name in (method, "pairwise"))
            head: Row = {"sequence": graph.sequence.name, "config": config, "variant": variant, "method": method}
            head |= {"min_matches": least, "loops": len(found), "failed": len(found) - len(both)}
            row = head | error_summary(mine, None if method == "pairwise" else pairs)
            rows.append(row | {f"paper_{c}": v for c, v in zip(COLUMNS, PAPER_NUMBERS[method], strict=True)})
    return rows


def _errors(loop: Loop, graph: Overlaps, edges: Matches, seed: int) -> Errors:
    """Degrees and centimetres of the motion from the first to the last scan, for every method and variant."""
    inputs = {(a, b): edge_matches(graph.points, (loop[a], loop[b]), edges[loop[a], loop[b]]) for a, b in NEEDED}
    truth = graph.true_motion(loop[0], loop[-1])
    results: Errors = {}
    for k, (method, segments) in enumerate(METHODS.items()):
        for variant, settings in VARIANTS.items():
            found = chained(segments, inputs, settings, np.random.default_rng([seed, k, *loop]))
            if found is not None:
                E = se3.inverse(truth) @ found[0]
                angle = float(se3.rotation_angle_deg(E[:3, :3]))
                results[method, variant] = (angle, 100 * float(np.linalg.norm(E[:3, 3])))
    return results


def error_summary(mine: Floats, pairs: Floats | None) -> Row:
    """Means and medians of errors `mine` (m, 2), degrees and cm; the shares better than and equal to `pairs` (m, 2)."""
    row: Row = dict.fromkeys((*COLUMNS, "rot_deg_median", "trans_cm_median"))
    for k, name in enumerate(("rot_deg", "trans_cm")):
        if len(mine):
            row |= {f"{name}_mean": float(mine[:, k].mean()), f"{name}_median": float(np.median(mine[:, k]))}
    if pairs is not None and len(mine):
        gain = pairs - mine
        equal = np.abs(gain) < [EQUAL_DEG, EQUAL_CM]
        for k, name in enumerate(("rot", "trans")):
            row[f"{name}_equal"] = float(equal[:, k].mean())
            row[f"{name}_better"] = float((~equal[:, k] & (gain[:, k] > 0)).mean())
    return {key: None if value is None else round(value, 6) for key, value in row.items()}


def draw(rows: Sequence[Row]) -> Figure:
    """Mean errors of every method beside the paper's; a group of bars a method."""
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    series = list(dict.fromkeys((row["sequence"], row["config"], row["variant"]) for row in rows))
    width = 0.8 / (len(series) + 1)
    panels = {"rot_deg_mean": "rotation error, mean [deg]", "trans_cm_mean": "translation error, mean [cm]"}
    for axes, (key, label) in zip(figure.subplots(1, 2), panels.items(), strict=True):
        paper = [PAPER_NUMBERS[method][COLUMNS.index(key)] for method in METHODS]
        axes.bar(np.arange(len(METHODS)), paper, width, color="lightgrey", label="paper, its three sequences")
        for k, name in enumerate(series, 1):
            mine = [row for row in rows if (row["sequence"], row["config"], row["variant"]) == name]
            heights = [row[key] if row[key] is not None else 0 for row in mine]
            axes.bar(np.arange(len(METHODS)) + k * width, heights, width, label=", ".join(name))
        axes.set_xticks(np.arange(len(METHODS)) + len(series) / 2 * width, list(METHODS))
        axes.set(ylabel=label, yscale="log")
        axes.grid(axis="y", which="both", alpha=0.3)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize="x-small")
    return figure
