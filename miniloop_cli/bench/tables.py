"""The paper's last tables on a recording: cycles of its graph, and errors of the final poses over the graph's edges."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from miniloop_cli.bench import Row
from miniloop_cli.bench.overlaps import Overlaps, overlaps, paper_sequence
from miniloop_cli.evaluation.errors import relative_errors
from miniloop_cli.graph.cycles import decompose
from miniloop_cli.graph.overlap import overlap_graph
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge
from miniloop_cli.scene.points import Matches
from miniloop_cli.scene.registration import Registration, RegistrationError
from miniloop_cli.typing import Bools, Floats

# The paper's, per sequence: pairs, 3-, 4-, 5-cycles of its graph; mean rotation (deg) and translation error (cm).
PAPER_CYCLES = {"freiburg1_room": (58, 1, 1, 74), "freiburg1_xyz": (57, 0, 1, 338), "freiburg2_desk": (53, 2, 2, 124)}
PAPER_ERRORS = {"freiburg1_room": (1.96, 4.52), "freiburg1_xyz": (0.740, 2.44), "freiburg2_desk": (1.33, 2.26)}
CYCLE_COLUMNS = ("pairwise", "cycle3", "cycle4", "cycle5")
EDGE_SHARES = (1.0, 0.75, 0.5, 0.25, 0.1)  # of all pairs, besides the paper's
RUNS = {  # runs: preset, and further changes
    "paper": ("paper", ("matching.pairs=exhaustive",)),
    "default": ("default", ()),
    "default, averaging only": ("default", ("refine=none",)),
}


def cycle_rows(graph: Overlaps, config: str, longest: int = 5) -> list[Row]:
    """Pairs, 3-, 4- and 5-cycles of the graph at several T, decomposed as in the paper (dfs) and as here (support)."""
    count = len(graph.points)
    pairs = count * (count - 1) // 2
    by_edges = {graph.least_for(round(share * pairs)) for share in EDGE_SHARES}
    known = paper_sequence(graph.sequence.name)
    rows = []
    for least in sorted({graph.least_as_in_paper, *by_edges}):
        edges = graph.with_matches(least)
        like = least == graph.least_as_in_paper
        for method in ("dfs", "support"):
            sizes = Counter(map(len, decompose(overlap_graph(count, edges), longest, method)))
            row: Row = {"table": "cycles", "sequence": graph.sequence.name, "config": config, "min_matches": least}
            row |= {"as_in_paper": like, "decomposition": method, "edges": len(edges)}
            row |= {name: sizes[n] for n, name in enumerate(CYCLE_COLUMNS, 2)}
            paper = PAPER_CYCLES[known] if like and known else (None,) * len(CYCLE_COLUMNS)
            rows.append(row | {f"paper_{name}": n for name, n in zip(CYCLE_COLUMNS, paper, strict=True)})
    return rows


def error_rows(folder: Path, graph: Overlaps, config: str, seed: int, workers: Workers) -> list[Row]:
    """Mean errors of the final relative poses over the edges of the paper-like graph, for every one of RUNS.

    All rows are measured on the same edges, except those of scans without a pose, which are counted. Rows also have the
    mean errors of the edges' own estimates, before averaging.
    """
    edges = graph.with_matches(graph.least_as_in_paper)
    known = paper_sequence(graph.sequence.name)
    rows = []
    for name, (preset, changes) in RUNS.items():
        settings = load_settings(preset, changes)
        if preset == "paper":  # which has its own T, for SURF
            own = overlaps(folder, settings, workers).least_as_in_paper
            settings = load_settings(preset, (*changes, "matching.edge_share=0", f"matching.min_matches={own}"))
        run: Registration | None
        try:
            run = register(graph.sequence, settings, Store(default_folder()), workers, seed)
        except RegistrationError as error:
            run = error.run
        row: Row = {"table": "errors", "sequence": graph.sequence.name, "config": config, "run": name}
        row |= {"min_matches": graph.least_as_in_paper, "edges": len(edges)}
        row |= _errors(run, graph, edges)
        paper = PAPER_ERRORS[known] if known else (None, None)
        rows.append(row | {"paper_rot_deg_mean": paper[0], "paper_trans_cm_mean": paper[1]})
    return rows


def _errors(run: Registration | None, graph: Overlaps, edges: Matches) -> Row:
    T_true, reached = graph.true_poses
    posed = np.zeros(len(reached), bool)
    final, own, errors = np.empty((0, 2), np.int64), list[Edge](), _means(None, None)
    if run:
        posed[run.poses.registered] = True
        both = posed & reached
        final = np.array([pair for pair in edges if both[list(pair)].all()], np.int64).reshape(-1, 2)
        if len(final):
            errors = _means(*relative_errors(run.poses.T_world_cam, T_true, final))
        own = [edge for edge in run.edges.edges() if edge.pair in edges and edge.inlier_count]
    row: Row = {"registered": int(posed.sum()), "frames": len(posed), "edges_scored": len(final)} | errors
    row["edges_of_run"] = len(run.edges) if run else 0
    return row | {f"estimate_{key}": value for key, value in _means(*_estimates(own, T_true, reached)).items()}


def _estimates(own: Sequence[Edge], T_true: Floats, reached: Bools) -> tuple[Floats | None, Floats | None]:
    """Errors, degrees and metres, of the edges' own estimates."""
    own = [edge for edge in own if reached[edge.i] and reached[edge.j]]
    if not own:
        return None, None
    # Each edge as two poses: scan i at the origin, scan j at its estimate.
    T = np.array([matrix for edge in own for matrix in (edge.T_j_i, np.eye(4))])
    true = np.array([matrix for edge in own for matrix in (T_true[edge.i], T_true[edge.j])])
    return relative_errors(T, true, np.arange(2 * len(own)).reshape(-1, 2))


def _means(deg: Floats | None, metres: Floats | None) -> Row:
    if deg is None or metres is None:
        return dict.fromkeys(("rot_deg_mean", "trans_cm_mean", "rot_deg_median", "trans_cm_median"))
    values = (deg.mean(), 100 * metres.mean(), np.median(deg), 100 * np.median(metres))
    names = ("rot_deg_mean", "trans_cm_mean", "rot_deg_median", "trans_cm_median")
    return {name: round(float(value), 4) for name, value in zip(names, values, strict=True)}


def table_rows(sequences: Iterable[Path], config: str, seed: int, workers: Workers) -> Iterator[Row]:
    """Both tables of each recording; `config`: settings of features and matching for the graph of the first."""
    settings = load_settings(config)
    for folder in sequences:
        graph = overlaps(folder, settings, workers)
        yield from cycle_rows(graph, config)
        yield from error_rows(folder, graph, config, seed, workers)


def draw(rows: Sequence[Row]) -> Figure:
    """Edges covered by each length against T, and the final errors beside the paper's."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    counted = [row for row in rows if row["table"] == "cycles" and row["decomposition"] == "dfs"]
    for k, sequence in enumerate(dict.fromkeys(row["sequence"] for row in counted)):
        mine = sorted((row for row in counted if row["sequence"] == sequence), key=lambda row: row["edges"])
        edges = [row["edges"] for row in mine]
        for row_key, scans, style in (("cycle5", 5, "o-"), ("pairwise", 1, "x--")):
            shares = [100 * scans * row[row_key] / max(row["edges"], 1) for row in mine]
            left.plot(edges, shares, style, color=f"C{k}", label=f"{sequence}: {row_key}")
    left.set(xlabel="edges of the graph", ylabel="edges covered [%]", ylim=(-3, 103))
    left.legend(fontsize="x-small")
    final = [row for row in rows if row["table"] == "errors" and row["rot_deg_mean"] is not None]
    names = [f"{row['sequence']}\n{row['run']}" for row in final]
    for axes, key, label in ((middle, "rot_deg_mean", "deg"), (right, "trans_cm_mean", "cm")):
        axes.barh(range(len(final)), [row[key] for row in final], color="C0", height=0.6)
        for k, row in enumerate(final):
            if row[f"paper_{key}"] is not None:
                axes.plot([row[f"paper_{key}"]] * 2, [k - 0.4, k + 0.4], color="C3")
        axes.set(xlabel=f"mean error [{label}]; red: paper", ylim=(len(final) - 0.5, -0.5))
        axes.set_yticks(range(len(final)), names if axes is middle else [""] * len(final), fontsize=7)
    return figure
