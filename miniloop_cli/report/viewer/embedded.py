"""The 3D view that a report carries: the scene, the model's points and small images of the frames."""

from __future__ import annotations

from typing import Any

import numpy as np

from miniloop_cli.errors import InputError
from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.report.viewer import packing
from miniloop_cli.report.viewer.frame_pictures import frame_pictures
from miniloop_cli.report.viewer.levels import coarse_first
from miniloop_cli.report.viewer.scene import scene
from miniloop_cli.results.columns import ReportData
from miniloop_cli.results.ply import read_ply
from miniloop_cli.runtime.artifact_store import Arrays, Artifact, Store, file_fingerprint

PACKED = Artifact("packed_points", 2)
MOST_POINTS = 2_000_000
FARTHEST_M = 1e6
SEVEN_BITS = np.uint8(0xFE)  # of a colour: the eighth is noise, and does not pack

Values = dict[str, Any]


def embedded(data: ReportData, evaluation: Evaluation | None, store: Store) -> Values | None:
    """The values of the template `view.html`; None for a run without frames."""
    if not len(data.frames):
        return None
    shown = scene(data, evaluation)
    model, points, notes = _model(data, store)
    if shown["edges"]["left_out"]:
        notes.append(f"{shown['edges']['left_out']} more edges are in edges.csv.")
    return {
        "scene": shown,
        "model": model,
        "points": points,
        "pictures": frame_pictures(data, store).values(),
        "notes": notes,
    }


def _model(data: ReportData, store: Store) -> tuple[Values | None, str, list[str]]:
    """What viewer.js must know of the points, these as base64, and what is to be said; None without a model."""
    path = data.results.root / "cloud.ply"
    if not path.is_file() or not (data.results.root / "trajectory.txt").is_file():
        return None, "", []

    def packed() -> Arrays:
        points, colors = read_ply(path)
        sane = np.isfinite(points).all(axis=1) & (np.abs(points) < FARTHEST_M).all(axis=1)
        points, colors = points[sane], colors[sane]
        levels = coarse_first(points).first(MOST_POINTS)
        steps = packing.coarser(levels.steps, levels.spacing)
        return {
            "packed": np.frombuffer(packing.pack_points(steps, colors[levels.order] & SEVEN_BITS), np.uint8),
            "levels": np.bincount(levels.level),
            "cube": np.r_[levels.corner, levels.side],
            "total": np.array([len(points)]),
        }

    try:
        kept = store.cached(PACKED, (file_fingerprint(path), MOST_POINTS), packed)
    except InputError:
        return None, "", []  # the section on the model says what is wrong with the file
    count, total = int(kept["levels"].sum()), int(kept["total"][0])
    if not count:
        return None, "", []
    notes = [] if count == total else [f"{count:,} of the {total:,} points; `miniloop view` shows all."]
    corner, side = kept["cube"][:3].tolist(), float(kept["cube"][3])
    meta = {"kind": "points", "count": count, "levels": kept["levels"].tolist(), "corner": corner, "side": side}
    return meta, packing.text(kept["packed"].tobytes()), notes
