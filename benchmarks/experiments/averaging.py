"""How fast and how well motion averaging solves view graphs with known poses."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.experiments.certificates import NOT_PROVEN, certificate_row
from benchmarks.experiments.view_graphs import ViewGraph, view_graph
from miniloop_cli.averaging.rotations import average_rotations
from miniloop_cli.averaging.translations import average_translations
from miniloop_cli.bench import Row
from miniloop_cli.geometry.procrustes import align_rotations
from miniloop_cli.geometry.se3 import pose, rotation_angle_deg
from miniloop_cli.runtime.blocks import Blocks
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.runtime.progress import track
from miniloop_cli.typing import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def averaging_rows(
    scans: Sequence[int],
    edges: int | None,
    outliers: Sequence[float],
    kind: Sequence[str],
    noise_deg: float,
    noise_m: float,
    certificate: bool,
    peers: bool,
    seed: int,
    workers: Workers,
) -> list[Row]:
    """Rows of every combination of kind, share of outliers and number of scans; without `edges` 5 a scan.

    Graphs are measured one after the other; the threads of `workers` share the loops of each.
    """
    _warm_up()
    rows = []
    for each, share, count in track(list(product(kind, outliers, scans)), "View graphs", quiet=workers.quiet):
        many = edges or min(5 * count, count * (count - 1) // 2)
        rows += graph_rows(each, count, many, share, noise_deg, noise_m, certificate, peers, seed, workers.threads)
    return rows


def graph_rows(
    kind: str,
    scans: int,
    edges: int,
    outliers: float,
    noise_deg: float,
    noise_m: float,
    certificate: bool,
    peers: bool,
    seed: int,
    jobs: int = 1,
) -> list[Row]:
    """One row for miniloop on a view graph, and with `peers` one for each peer installed.

    Times are wall-clock seconds with everything compiled, and CPU seconds of both averagings; `load`: the system's load
    average before, None where it tells none; `peak_mb`: the process's largest resident memory so far, graph and
    interpreter included. Errors are of the scans' poses after the best alignment with the true ones.
    """
    graph = view_graph(kind, scans, edges, outliers, noise_deg, noise_m, np.random.default_rng(seed))
    head: Row = {"kind": kind, "scans": scans, "edges": edges, "outliers": outliers}
    head |= {"noise_deg": noise_deg, "noise_m": noise_m, "seed": seed, "jobs": jobs}
    head |= {"load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None}
    mine, T_world_cam = measure_miniloop(graph, jobs)
    proof = certificate_row(graph, T_world_cam, noise_deg, noise_m) if certificate else NOT_PROVEN
    rows = [head | {"method": "miniloop"} | mine | proof]
    if peers:
        from benchmarks.experiments.peers.averaging import installed

        rows += [
            head | {"method": name} | measure_peer(graph, solve) | NOT_PROVEN
            for name, solve in installed(scans).items()
        ]
    return rows


def measure_miniloop(graph: ViewGraph, jobs: int = 1) -> tuple[Row, Floats]:
    """Both averagings, and the poses (n, 4, 4).

    Translations take edges by how well their rotations agree, as the pipeline does.
    """
    start, before = time.perf_counter(), time.process_time()
    R_j_i, t_j_i = graph.T_j_i[:, :3, :3], graph.T_j_i[:, :3, 3]
    with Blocks(jobs) as blocks:
        rotations = average_rotations(len(graph.T_world_cam), graph.pairs, R_j_i, blocks=blocks)
        middle = time.perf_counter()
        weights = 1 / (1 + (rotations.residual_deg / 3) ** 2) ** 2
        translations = average_translations(rotations.R_world_cam, graph.pairs, t_j_i, weights, blocks=blocks)
    end, cpu_s = time.perf_counter(), time.process_time() - before
    row: Row = {
        "seconds": end - start,
        "cpu_seconds": cpu_s,
        "rotation_seconds": middle - start,
        "translation_seconds": end - middle,
    }
    row |= errors(graph, rotations.R_world_cam, translations.t_world_cam)
    row |= {"peak_mb": _peak_mb(), "converged": rotations.converged and translations.converged}
    row |= {"rotation_iterations": rotations.iterations, "translation_iterations": translations.iterations}
    return row, pose(rotations.R_world_cam, translations.t_world_cam)


def measure_peer(graph: ViewGraph, solve: Callable[[ViewGraph], tuple[Floats, float]]) -> Row:
    """A peer's rotations: `solve` gives them with the seconds of its own call, without the setting up."""
    R_world_cam, seconds = solve(graph)
    row: Row = {"seconds": seconds, "cpu_seconds": None, "rotation_seconds": seconds, "translation_seconds": None}
    return row | errors(graph, R_world_cam, None) | {"peak_mb": _peak_mb(), "converged": None}


def errors(graph: ViewGraph, R_world_cam: Floats, t_world_cam: Floats | None) -> Row:
    """Median and mean rotation error (deg), median translation error (m), after robust alignment with the truth."""
    true = graph.T_world_cam[:, :3, :3]
    R_align = np.eye(3)
    angle = np.full(len(true), 1.0)
    for _ in range(10):  # Weiszfeld's iterations: the rotation that most scans agree on
        R_align = align_rotations(R_world_cam, true, 1 / np.maximum(angle, 0.1))
        angle = rotation_angle_deg(np.swapaxes(true, 1, 2) @ (R_align @ R_world_cam))
    row: Row = {"rot_err_deg_median": float(np.median(angle)), "rot_err_deg_mean": float(angle.mean())}
    if t_world_cam is None:
        return row | {"trans_err_median": None}
    offset = graph.T_world_cam[:, :3, 3] - t_world_cam @ R_align.T
    return row | {"trans_err_median": float(np.median(np.linalg.norm(offset - np.median(offset, axis=0), axis=1)))}


def draw(rows: Sequence[Row]) -> Figure:
    """Seconds and median rotation error over the number of scans, a line for every kind, share and method."""
    from matplotlib.figure import Figure  # late: it would count in the memory that is measured

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    names = dict.fromkeys((row["method"], row["kind"], row["outliers"]) for row in rows)
    for name in names:
        mine = sorted((r for r in rows if (r["method"], r["kind"], r["outliers"]) == name), key=lambda r: r["scans"])
        label = f"{name[0]}, {name[1]}, {100 * name[2]:g} % outliers"
        scans = [row["scans"] for row in mine]
        left.plot(scans, [row["seconds"] for row in mine], "o-", label=label)
        right.plot(scans, [row["rot_err_deg_median"] for row in mine], "o-")
    left.set(xscale="log", yscale="log", xlabel="scans", ylabel="seconds")
    right.set(xscale="log", yscale="log", xlabel="scans", ylabel="median rotation error, degrees")
    left.legend(fontsize="x-small")
    return figure


def _warm_up() -> None:
    """Compile, or load what is compiled, for small and large graphs."""
    for scans in (20, 400):
        measure_miniloop(view_graph("video", scans, 4 * scans, 0.1, 0.5, 0.01, np.random.default_rng(0)))


def _peak_mb() -> float:
    import resource  # there is none on Windows, where the rest of the package is imported, too

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10
