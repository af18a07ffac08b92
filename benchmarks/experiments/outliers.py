"""How averaging, the residual test and the pose graph stand false edges, beside the robust back-ends of others."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.experiments.averaging import errors
from benchmarks.experiments.false_edges import KINDS, Solution, Solve, TrueGraph, true_graph, with_false_edges
from benchmarks.experiments.view_graphs import ViewGraph
from miniloop_cli.api import simulate
from miniloop_cli.bench import Row
from miniloop_cli.config import Averaging
from miniloop_cli.geometry.procrustes import align_points
from miniloop_cli.refinement.posegraph import refine_pose_graph
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import usable_edges
from miniloop_cli.typing import Bools
from miniloop_cli.verification.consensus import average_verified
from miniloop_cli.verification.photometric_check import PhotometricCheck

SIMULATED = {"simulated-loop": "loop", "simulated-walk": "random-walk"}  # names and paths
MAX_ERROR_FACTOR = 2.0  # times the error on the clean graph
LEAST_POSED = 0.95  # of the scans that the clean graph places


def miniloop(graph: TrueGraph, edges: EdgeTable, photometric: PhotometricCheck | None = None) -> Solution:
    """As the pipeline does it, up to the pose graph over the edges that are left."""
    count = len(graph.T_world_cam)
    poses, judged = average_verified(edges, count, Averaging(), photometric)
    posed = poses.component == 0
    inside = judged.subset(usable_edges(judged, count) & poses.joins(judged))
    if not len(inside):
        return poses.T_world_cam, posed, judged
    refined = refine_pose_graph(poses.T_world_cam, inside.pairs, inside.T_j_i, inside.information)
    return refined.T_world_cam, posed, judged


def looking(graph: TrueGraph, edges: EdgeTable) -> Solution:
    """As `miniloop`, with the scans' pictures and depth to be asked about edges, as in `miniloop register`."""
    return miniloop(graph, edges, graph.photometric)


METHODS: dict[str, Solve] = {"miniloop": looking, "miniloop, edges only": miniloop}


def outlier_rows(
    sequences: Sequence[Path],
    simulated: bool,
    max_frames: int,
    percent: Sequence[float],
    runs: int,
    peers: bool,
    seed: int,
    workers: Workers,
) -> Iterator[Row]:
    """Rows of the true graph of each recording, and of two `simulated` ones; `percent` of the edges are false."""
    methods = dict(METHODS)
    if peers:
        from benchmarks.experiments.peers.outliers import installed

        methods |= installed()
    with tempfile.TemporaryDirectory() as root:
        folders = list(sequences)
        for name, path in SIMULATED.items() if simulated else ():
            folders.append(simulate(Path(root) / name, seed=seed, frames=max_frames, width=320, height=240, path=path))
        for folder in folders:
            graph = true_graph(folder, max_frames, seed, workers)
            yield from graph_rows(graph, [value / 100 for value in percent], runs, seed, methods)


def graph_rows(
    graph: TrueGraph, shares: Sequence[float], runs: int, seed: int = 0, methods: Mapping[str, Solve] = METHODS
) -> Iterator[Row]:
    """One row a kind of false edges, share and method; every method sees the same graphs.

    A run is within bounds if its error is at most MAX_ERROR_FACTOR times that of the same method on the clean graph,
    and at least LEAST_POSED of the scans have a pose: `within_share` by positions (ATE), `rot_within_share` by
    rotations.
    """
    clean = {
        name: _measured(graph, graph.edges, np.zeros(len(graph.edges), bool), solve) for name, solve in methods.items()
    }
    for kind in KINDS:
        for share in shares:
            found: dict[str, list[Row]] = {name: [] for name in methods}
            for run in range(runs):
                rng = np.random.default_rng([seed, KINDS.index(kind), round(1000 * share), run])
                edges, false = with_false_edges(graph, kind, share, rng)
                for name, solve in methods.items():
                    found[name].append(_measured(graph, edges, false, solve))
            for name, mine in found.items():
                head = {"sequence": graph.name, "kind": kind, "share": share, "method": name, "runs": runs}
                head |= {"scans": len(graph.scans), "edges": len(graph.edges)}
                yield head | _summary(mine, clean[name])


def _measured(graph: TrueGraph, edges: EdgeTable, false: Bools, solve: Solve) -> Row:
    """Errors of a method's result over the scans that the true edges connect."""
    begin = time.perf_counter()
    T, posed, judged = solve(graph, edges)
    row: Row = {"seconds": time.perf_counter() - begin}
    scans = graph.scans[posed[graph.scans]]
    row |= {"posed": len(scans) / len(graph.scans), "false_share": float(false.mean())}
    row |= {"ate_cm": None, "rot_deg": None, "false_kept": None, "true_lost": None}
    if len(scans) >= 3:
        T_true = graph.T_world_cam[scans]
        truth = ViewGraph(T_true, np.empty((0, 2), np.int64), T_true, false)
        row["rot_deg"] = errors(truth, T[scans, :3, :3], None)["rot_err_deg_mean"]
        if np.isfinite(T[scans, :3, 3]).all():
            moved = align_points(T[scans, :3, 3], T_true[:, :3, 3]).points(T[scans, :3, 3])
            row["ate_cm"] = 100 * float(np.sqrt(((moved - T_true[:, :3, 3]) ** 2).sum(axis=1).mean()))
    if judged is not None:
        row["false_kept"] = float(judged.open[false].mean()) if false.any() else 0.0
        row["true_lost"] = float((~judged.open[~false]).mean())
    return row


def _summary(found: Sequence[Row], clean: Row) -> Row:
    def within(key: str) -> float | None:
        if clean[key] is None:
            return None
        least = LEAST_POSED * clean["posed"]
        return float(
            np.mean(
                [r[key] is not None and r[key] <= MAX_ERROR_FACTOR * clean[key] and r["posed"] >= least for r in found]
            )
        )

    row: Row = {"within_share": within("ate_cm"), "rot_within_share": within("rot_deg")}
    for key in ("ate_cm", "rot_deg"):
        values = [r[key] for r in found if r[key] is not None]
        row |= {f"clean_{key}": clean[key], f"{key}_median": float(np.median(values)) if values else None}
    for key in ("false_share", "posed", "false_kept", "true_lost", "seconds"):
        values = [r[key] for r in found if r[key] is not None]
        row[f"{key}_mean" if key != "false_share" else key] = float(np.mean(values)) if values else None
    return {key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()}


def draw(rows: Sequence[Row]) -> Figure:
    """Share of runs within bounds against the share of false edges: a row of panels a kind, a panel a recording."""
    sequences, methods = (list(dict.fromkeys(row[key] for row in rows)) for key in ("sequence", "method"))
    figure = Figure(figsize=(1 + 3.4 * len(sequences), 6), layout="constrained")
    panels = figure.subplots(len(KINDS), len(sequences), sharex=True, sharey=True, squeeze=False)
    for line, kind in zip(panels, KINDS, strict=True):
        for axes, sequence in zip(line, sequences, strict=True):
            for k, method in enumerate(methods):
                mine = [r for r in rows if (r["sequence"], r["kind"], r["method"]) == (sequence, kind, method)]
                key = "within_share" if mine and mine[0]["within_share"] is not None else "rot_within_share"
                label = method if key == "within_share" else f"{method} (rotations)"
                shares, good = [100 * r["share"] for r in mine], [100 * r[key] for r in mine]
                axes.plot(shares, good, "o-" if k < len(METHODS) else "x--", color=f"C{k}", label=label, alpha=0.8)
            axes.set_title(f"{sequence}, {kind}", fontsize=9)
            axes.set(ylim=(-4, 104))
            axes.grid(alpha=0.3)
    for axes in panels[-1]:
        axes.set_xlabel("false edges [%]")
    for axes in panels[:, 0]:
        axes.set_ylabel("runs within 2 x clean error [%]")
    panels[0, 0].legend(fontsize="x-small")
    return figure
