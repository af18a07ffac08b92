"""The 3D view in a report: the scene, the model's points and small images of the frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.errors import InputError
from miniloop_cli.evaluation.evaluate import Evaluation
from miniloop_cli.report.viewer import packing
from miniloop_cli.report.viewer.frame_pictures import FramePictures, frame_pictures
from miniloop_cli.report.viewer.levels import coarse_first
from miniloop_cli.report.viewer.map_scene import MapData, cloud_files, map_cloud, map_scene
from miniloop_cli.report.viewer.scene import scene
from miniloop_cli.results.columns import ReportData
from miniloop_cli.results.ply import read_ply
from miniloop_cli.runtime.artifact_store import Arrays, Artifact, Store, file_fingerprint
from miniloop_cli.typing import Bytes

PACKED = Artifact("packed_points", 2)
MOST_POINTS = 2_000_000
FARTHEST_M = 1e6
SEVEN_BITS = np.uint8(0xFE)  # of a colour: the eighth is noise, and does not compress

Values = dict[str, Any]
Made = tuple[Values | None, str, Sequence[str]]
NO_MODEL: Made = (None, "", ())


def embedded(data: ReportData, evaluation: Evaluation | None, store: Store) -> Values | None:
    """The values of the template `view.html`; None for a run without frames."""
    if not len(data.frames):
        return None
    path = data.results.root / "cloud.ply"
    has_model = path.is_file() and (data.results.root / "trajectory.txt").is_file()
    made = _model(lambda: read_ply(path), file_fingerprint(path), store) if has_model else NO_MODEL
    return _values(scene(data, evaluation), made, frame_pictures(data, store))


def embedded_map(data: MapData, result: Path, store: Store) -> Values:
    """The values of the template `view.html` for a map of several recordings. Raises InputError for a damaged file."""
    clouds = [file_fingerprint(path) for path, _ in cloud_files(data, result)]
    made = _model(lambda: map_cloud(data, result), (clouds, data.T_shown), store)
    share = len(data.runs)
    pictures = [frame_pictures(run, store, share) for run in data.runs]
    return _values(map_scene(data), made, FramePictures.of_several(pictures, data.first.tolist()))


def _values(shown: Values, made: Made, pictures: FramePictures) -> Values:
    model, points, notes = made
    if shown["edges"]["left_out"]:
        notes = [*notes, f"{shown['edges']['left_out']} more edges are in edges.csv."]
    return {"scene": shown, "model": model, "points": points, "pictures": pictures.values(), "notes": notes}


def _model(read: Callable[[], tuple[NDArray[np.floating], Bytes]], key: Any, store: Store) -> Made:
    """Values of the points for viewer.js, the points as base64, and a remark; None without a model."""

    def packed() -> Arrays:
        points, colors = read()
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
        kept = store.cached(PACKED, (key, MOST_POINTS), packed)
    except InputError:
        return NO_MODEL  # the section on the model reports the damage
    count, total = int(kept["levels"].sum()), int(kept["total"][0])
    if not count:
        return NO_MODEL
    notes = [] if count == total else [f"{count:,} of the {total:,} points; `miniloop view` shows all."]
    corner, side = kept["cube"][:3].tolist(), float(kept["cube"][3])
    meta = {"kind": "points", "count": count, "levels": kept["levels"].tolist(), "corner": corner, "side": side}
    return meta, packing.text(kept["packed"].tobytes()), notes
