"""How time and memory grow with the length of a recording, and which loops between its visits to a place are found."""

from __future__ import annotations

import csv
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.experiments import whole
from benchmarks.side_by_side import measured
from miniloop_cli.bench import Row
from miniloop_cli.bench.overlaps import open_with_truth
from miniloop_cli.datasets import read_scan
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.simulation.layout import ROOM_M, Layout
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.tour import duration_s
from miniloop_cli.simulation.write import write_sequence
from miniloop_cli.typing import Bools, Floats, Ints

RATE_HZ = 30.0
SAMPLED_S = 1.0  # one frame in so many seconds is asked what it sees
APART_S = 15.0  # frames that see the same thing later than this close a loop
OVERLAP = 0.4  # share of a frame's points that the other one sees, both ways
NEAR_S = 1.0  # an edge between frames so near to both ends is that loop
STRIDE_PX, BESIDE = 16, 0.05  # points asked of each frame; share of their depth by which they may be off


def growth_rows(
    frames: Sequence[int] = (1000, 3000, 10_000),
    width: int = 320,
    runs: Path = Path("results/growth"),
    seed: int = 0,
    workers: Workers | None = None,
) -> Iterator[Row]:
    """One row a length; `runs` keeps the recordings, and what `miniloop register` left of each."""
    for count in frames:
        folder, rooms = runs.resolve() / f"rooms_{count}_{width}_{seed}", rooms_for(count)
        if not folder.exists():
            size = {"frames": count, "width": width, "height": width * 3 // 4, "rate_hz": RATE_HZ}
            write_sequence(folder, SimulationSettings(rooms=rooms, **size), seed)
        job = whole.miniloop_job(folder, runs.resolve() / f"register_{count}_{width}_{seed}", seed)
        subprocess.run([sys.executable, measured.__file__, str(job.out), *job.command], check=True)
        row: Row = {"frames": count, "rooms": rooms, "poses": None, "ate_cm": None} | whole.result(job, folder)
        row |= {"cpu_ms": 1000 * row["cpu_s"] / count, "wall_ms": 1000 * row["wall_s"] / count}
        row |= {"loops": None, "found_share": None, "between": None, "between_share": None, "said": row.get("said", "")}
        if row["poses"] is not None:
            row |= loop_recall(folder, job.out.with_suffix(".edges.csv"), rooms)
        yield row


def rooms_for(frames: int) -> int:
    """As many rooms, an even number, as a person walks through in so many frames; at least two."""
    rooms = 2
    while duration_s(Layout(rooms + 2)) <= frames / RATE_HZ:
        rooms += 2
    return rooms


def loop_recall(folder: Path, edges: Path, rooms: int) -> Row:
    """Pairs of sampled frames that see the same place at different visits, and the share that verified edges join.

    `between`: those of them that are taken from different rooms, through a door.
    """
    sequence, truth = open_with_truth(folder)
    stamps = np.array([frame.timestamp_s for frame in sequence.frames])
    sampled = np.unique(np.searchsorted(stamps, np.arange(stamps[0], stamps[-1], SAMPLED_S)))
    T, known = associate(stamps[sampled], truth)
    sampled, T = sampled[known], T[known]
    depth_m = np.array([read_scan(sequence, int(k)).depth_m for k in sampled])
    pairs = seen_again(depth_m, T, sequence.camera.K, stamps[sampled])
    with edges.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["verdict"] == "verified"]
    joined = np.array([[float(row["timestamp_i"]), float(row["timestamp_j"])] for row in rows]).reshape(-1, 2)
    found = joined_by(stamps[sampled][pairs], np.sort(joined, axis=1))
    centres = np.array([Layout(rooms).centre_m(room)[:2] for room in range(rooms)])
    room = np.abs((T[:, None, :2, 3] - centres) / ROOM_M[:2]).max(axis=2).argmin(axis=1)
    between = room[pairs[:, 0]] != room[pairs[:, 1]]
    return {
        "loops": len(pairs),
        "found_share": float(found.mean()) if len(pairs) else None,
        "between": int(between.sum()),
        "between_share": float(found[between].mean()) if between.any() else None,
    }


def joined_by(pairs_s: Floats, edges_s: Floats) -> Bools:
    """(n,) whether an edge (m, 2) joins frames within NEAR_S of both stamps of a pair (n, 2); both sorted in rows."""
    order = np.argsort(edges_s[:, 0], kind="stable")
    edges_s = edges_s[order]
    low = np.searchsorted(edges_s[:, 0], pairs_s[:, 0] - NEAR_S)
    high = np.searchsorted(edges_s[:, 0], pairs_s[:, 0] + NEAR_S, side="right")
    ends = zip(low, high, pairs_s[:, 1], strict=True)
    return np.array([bool((np.abs(edges_s[a:b, 1] - stamp) <= NEAR_S).any()) for a, b, stamp in ends], bool)


def seen_again(depth_m: Floats, T_world_cam: Floats, K: Floats, stamps_s: Floats) -> Ints:
    """(m, 2) pairs of frames, the earlier first, at least APART_S apart, that overlap by OVERLAP both ways.

    depth_m (n, h, w), poses (n, 4, 4), K (3, 3) without lens, (n,) sorted stamps. A point of one frame is seen by
    another if it lies in its image at the depth that is measured there.
    """
    n, h, w = depth_m.shape
    v, u = np.mgrid[STRIDE_PX // 2 : h : STRIDE_PX, STRIDE_PX // 2 : w : STRIDE_PX].reshape(2, -1)
    rays = np.linalg.solve(K, np.stack([u, v, np.ones_like(u)]).astype(float)).T
    shares = np.zeros((n, n), np.float32)
    for i in range(n):
        z = depth_m[i, v, u]
        p_world = se3.transform(T_world_cam[i], (rays * z[:, None])[z > 0])
        far = np.flatnonzero(np.abs(stamps_s - stamps_s[i]) >= APART_S)
        for j in far:
            p = se3.transform(se3.inverse(T_world_cam[j]), p_world)
            p = p[p[:, 2] > 0.1]
            x, y = np.round((p[:, :2] / p[:, 2:]) @ K[:2, :2].T + K[:2, 2]).astype(int).T
            inside = (x >= 0) & (x < w) & (y >= 0) & (y < h)
            there = depth_m[j, y[inside], x[inside]]
            same = np.abs(there - p[inside, 2]) < BESIDE * p[inside, 2]
            shares[i, j] = same.sum() / max(len(p_world), 1)
    return np.argwhere(np.triu(np.minimum(shares, shares.T) >= OVERLAP, 1))


def draw(rows: Sequence[Row]) -> Figure:
    """Milliseconds a frame and peak memory against the number of frames."""
    figure = Figure(figsize=(8, 3.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes, key, label in ((left, "cpu_ms", "CPU ms a frame"), (right, "peak_mb", "peak [MB]")):
        axes.plot([row["frames"] for row in rows], [row[key] for row in rows], "o-")
        axes.set(xlabel="frames", ylabel=label, xscale="log", ylim=(0, None))
    return figure
