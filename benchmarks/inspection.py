"""Faults that `miniloop inspect` names; Markdown tables.

Sound recordings, simulated and real, get one fault each in memory, then are inspected. A fault counts as found if the
right finding is among the warnings and problems; as misnamed if only others are. Sound ones are to raise none.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from miniloop_cli.datasets import open_sequence, read_scan
from miniloop_cli.inspection.inspect import inspect
from miniloop_cli.scene.sequence import Scan, Sequence
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence

PATHS = ("loop", "xyz", "rotation", "random-walk")
# All, every second, every third frame; the first, middle and last 50; the first 20.
PARTS = (slice(None), slice(None, None, 2), slice(None, None, 3), slice(50), slice(25, 75), slice(50, None), slice(20))
BASELINE_M, IR_FOCAL = 0.025, 585 / 525  # of a Kinect: colour and depth camera are 2.5 cm apart, and differ
Change = Callable[[np.ndarray, Sequence], np.ndarray]


def own_pixels(depth_m: np.ndarray, sequence: Sequence) -> np.ndarray:
    """(h, w) depth as the depth camera beside the colour camera has it before it is registered to colour."""
    camera = sequence.camera
    v, u = np.nonzero(depth_m)
    z = depth_m[v, u]
    x = (u - camera.cx) / camera.fx * z + BASELINE_M
    y = (v - camera.cy) / camera.fy * z
    px = np.round(np.column_stack([x / z * camera.fx, y / z * camera.fy]) * IR_FOCAL + [camera.cx, camera.cy])
    px = px.astype(int)
    seen = ((px >= 0) & (px < [camera.width, camera.height])).all(axis=1)
    order = np.flatnonzero(seen)[np.argsort(-z[seen])]  # the nearest is written last
    out = np.zeros_like(depth_m)
    out[px[order, 1], px[order, 0]] = z[order]
    holes = out == 0  # cracks between enlarged pixels, which a real depth image has not
    return np.where(holes, cv2.medianBlur(out.astype(np.float32), 3), out)


def moved(depth_m: np.ndarray, sequence: Sequence) -> np.ndarray:
    """(h, w) depth moved by 3 % of the width."""
    M = np.array([[1, 0, round(0.03 * sequence.camera.width)], [0, 1, 0]], np.float32)
    return cv2.warpAffine(depth_m, M, depth_m.shape[::-1], flags=cv2.INTER_NEAREST)


def focal(factor: float) -> Callable[[Sequence], Sequence]:
    """A recording with a camera whose focal length is `factor` times the true one."""

    def change(sequence: Sequence) -> Sequence:
        camera = sequence.camera
        return replace(sequence, camera=replace(camera, fx=factor * camera.fx, fy=factor * camera.fy))

    return change


def run(sequence: Sequence, change: Change | None = None, order: np.ndarray | None = None, seed: int = 0) -> set[str]:
    """Codes of the warnings and problems that an inspection finds."""
    loaded = lru_cache(maxsize=None)(lambda index: read_scan(sequence, index))

    def read(_: Sequence, index: int) -> Scan:
        scan = loaded(index)
        depth_m = scan.depth_m if order is None else loaded(int(order[index])).depth_m
        return replace(scan, depth_m=np.ascontiguousarray(change(depth_m, sequence) if change else depth_m, np.float32))

    found = inspect(sequence, np.random.default_rng(seed), read).findings
    return {finding.code for finding in found if finding.level != "note"}


def faults(sequence: Sequence, seed: int) -> dict[str, tuple[set[str], set[str]]]:
    """Fault to the codes that name it and the codes that were found."""
    n = len(sequence.frames)
    blind = replace(sequence, ground_truth_path=None)
    mixed = np.random.default_rng(seed).permutation(n)
    late = np.maximum(np.arange(n) - 2, 0)
    few = np.arange(n)
    few[[n // 4, 3 * n // 4]] = few[[3 * n // 4, n // 4]]
    return {
        "none": (set(), run(sequence)),
        "none, no ground truth": (set(), run(blind)),
        "depth x 1.2": ({"depth-scale"}, run(sequence, lambda d, _: 1.2 * d)),
        "depth x 1.2, no ground truth": ({"depth-scale"}, run(blind, lambda d, _: 1.2 * d)),
        "camera 525 instead of 450": ({"wrong-camera"}, run(focal(525 / 450)(blind))),
        "camera 450 instead of 525": ({"wrong-camera"}, run(focal(450 / 525)(blind))),
        "depth in random order": ({"swapped-depth"}, run(blind, order=mixed)),
        "depth 2 frames late": ({"swapped-depth"}, run(blind, order=late)),
        "depth of two frames swapped": ({"swapped-depth"}, run(blind, order=few)),
        "depth moved by 3 % of the width": ({"unregistered-depth"}, run(blind, moved)),
        "depth in the depth camera's own pixels": ({"unregistered-depth"}, run(blind, own_pixels)),
        "depth mirrored": ({"mirrored-depth"}, run(blind, lambda d, _: np.fliplr(d))),
    }


def table(groups: dict[str, list[Sequence]]) -> None:
    """One column a group of recordings: found of all, and what was said instead."""
    cells: dict[str, dict[str, list[int]]] = defaultdict(lambda: defaultdict(lambda: [0, 0, 0]))
    other: dict[str, Counter[str]] = defaultdict(Counter)
    for group, sequences in groups.items():
        for seed, sequence in enumerate(sequences):
            for fault, (right, found) in faults(sequence, seed).items():
                cell = cells[fault][group]
                cell[0] += not found if not right else bool(right & found)
                cell[1] += 1
                if not right or not right & found:
                    other[fault].update(found or ({"nothing"} if right else set()))
        print(f"{group} done", file=sys.stderr, flush=True)
    print("| fault | " + " | ".join(groups) + " | else |\n" + "|---" * (len(groups) + 2) + "|")
    for fault, row in cells.items():
        texts = [f"{row[group][0]} of {row[group][1]}" for group in groups]
        said = ", ".join(f"{code} {count}" for code, count in other[fault].most_common())
        print(f"| {fault} | " + " | ".join(texts) + f" | {said} |")


def show(recordings: Iterable[Path], seeds: int) -> None:
    """Print a table of so many simulated recordings a path, and one of PARTS of the `recordings`."""
    with tempfile.TemporaryDirectory() as folder:
        simulated: dict[str, list[Sequence]] = {}
        for path in PATHS if seeds else ():
            settings = SimulationSettings(frames=20, width=320, height=240, path=path)
            written = [write_sequence(Path(folder) / f"{path}{seed}", settings, seed=seed) for seed in range(seeds)]
            simulated[path] = [open_sequence(each) for each in written]
        if simulated:
            table(simulated)
    if real := [open_sequence(recording) for recording in recordings]:
        table({each.name: [replace(each, frames=each.frames[p], available=(0, 0)) for p in PARTS] for each in real})
