"""What the choice of candidates costs: verified edges lost, and CPU seconds, against comparing all pairs exactly."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.experiments.feature_store import FeatureStore
from benchmarks.experiments.own_inliers import judged_by_inliers
from miniloop_cli.bench import Row
from miniloop_cli.datasets import open_sequence, read_ground_truth
from miniloop_cli.evaluation.evaluate import Protocol, evaluate
from miniloop_cli.pipeline import register
from miniloop_cli.presets import load_settings
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.registration import Registration
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Pair

WAYS = {  # every name with the settings that make it
    "exhaustive": ("matching.pairs=exhaustive",),
    "auto": ("matching.pairs=auto",),
    "retrieval": ("matching.pairs=auto", "matching.exhaustive_max_scans=2"),
}


def recall_rows(
    sequences: Sequence[Path], max_frames: int, overrides: Sequence[str], seed: int, workers: Workers
) -> Iterator[Row]:
    """A row a recording and way of choosing candidates, the exhaustive one first.

    `kept`: share of the edges that were verified after comparing all pairs exactly which are verified now, each by its
    own inliers; `matching_share`: CPU seconds of matching over those of the exhaustive way.
    """
    store = FeatureStore(default_folder())
    _warm_up(sequences[0], store, workers)
    for folder in sequences:
        sequence = open_sequence(folder, max_frames=max_frames)
        truth = read_ground_truth(sequence)
        stamps = np.array([frame.timestamp_s for frame in sequence.frames])
        first: tuple[set[Pair], float] | None = None
        for name, changes in WAYS.items():
            run = register(sequence, load_settings("default", (*overrides, *changes)), store, workers, seed)
            found, matching_cpu_s = _verified(run), run.cpu_timings_s["matching"]
            first = first or (found, matching_cpu_s)
            registered = run.poses.registered
            row: Row = {"sequence": sequence.name, "frames": len(stamps), "candidates": name, "verified": len(found)}
            row |= {"kept": round(len(found & first[0]) / max(len(first[0]), 1), 4), "edges": len(run.edges)}
            row |= {"matching_s": run.timings_s["matching"], "matching_cpu_s": matching_cpu_s}
            row |= {"matching_share": round(matching_cpu_s / max(first[1], 1e-9), 3), "registered": len(registered)}
            ate = None
            if truth is not None and len(registered) > 2:
                poses = Trajectory(stamps[registered], run.poses.T_world_cam[registered])
                ate = round(100 * evaluate(poses, truth, None, Protocol()).numbers["ate_rmse_m"], 4)
            yield row | {"ate_cm": ate}


def _verified(run: Registration) -> set[Pair]:
    judged = judged_by_inliers(run.edges, run.settings.verification)
    return {(i, j) for i, j in judged.pairs[judged.verified].tolist()}


def _warm_up(folder: Path, store: Store, workers: Workers) -> None:
    """Load or compile what is compiled, on a few frames."""
    few = open_sequence(folder, max_frames=4)
    for changes in WAYS.values():
        register(few, load_settings("default", changes), store, Workers(workers.jobs), 0)


def draw_recall(rows: Sequence[Row]) -> Figure:
    """Share of verified edges kept over the share of the matching time, a colour a recording."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for colour, sequence in enumerate(dict.fromkeys(row["sequence"] for row in rows)):
        mine = [row for row in rows if row["sequence"] == sequence]
        x, y = [row["matching_share"] for row in mine], [100 * row["kept"] for row in mine]
        axes.plot(x, y, "o", color=f"C{colour}", label=sequence)
        for row, place in zip(mine, zip(x, y, strict=True), strict=True):
            axes.annotate(row["candidates"], place, xytext=(5, 4), textcoords="offset points", fontsize="small")
    axes.axhline(98, color="grey", linewidth=0.8, linestyle=":")
    axes.axvline(1 / 3, color="grey", linewidth=0.8, linestyle=":")
    axes.set(xlabel="CPU seconds of matching, exhaustive = 1", ylabel="verified edges kept [%]", xlim=(0, 1.15))
    axes.legend(fontsize="small")
    return figure
