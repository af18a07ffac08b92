"""`write_map_page`: one self-contained page of a map: its recordings and their joints."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from miniloop_cli.mapping.carry import map_trajectories
from miniloop_cli.report.charts import CAMERA_VIEWS
from miniloop_cli.report.svg import Chart, limits
from miniloop_cli.report.templating import asset, render
from miniloop_cli.report.viewer.embedded import embedded_map
from miniloop_cli.report.viewer.map_scene import load_map
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.scene.scene_map import SceneMap
from miniloop_cli.version import __version__

MOST_JOINS = 600  # lines of edges between recordings: more only fill the picture
COLOURS = 6  # classes of lines, repeated for more recordings


def write_map_page(result: Path, scene_map: SceneMap, numbers: Mapping[str, Any], store: Store) -> Path:
    """Write `report.html` into the folder of a map of several recordings; `numbers`: its summary.json.

    Images are from recordings that can be opened. Raises InputError for malformed files.
    """
    numbered = [recording | {"number": k} for k, recording in enumerate(numbers["recordings"])]
    pieces = [[r for r in numbered if r["piece"] == piece] for piece in range(numbers["pieces"])]
    joins = [
        (f"{j['a']} and {j['b']}", j["edges"], f"{j['keyframes_a']} and {j['keyframes_b']}") for j in numbers["joins"]
    ]
    page = render(
        "map.html",
        name=result.resolve().name,
        version=__version__,
        style=asset("page.css") + asset("viewer/assets/viewer.css"),
        viewer=asset("viewer/assets/viewer.js"),
        view=embedded_map(load_map(result, scene_map), result, store),
        numbers=numbers,
        pieces=pieces,
        joins=joins,
        charts=[_charts(scene_map, piece) for piece in range(numbers["pieces"])],
    )
    path = result / "report.html"
    with atomic_write(path) as file:
        file.write(page)
    return path


def _charts(scene_map: SceneMap, piece: int) -> list[Chart]:
    """Top and side view of the trajectories of a piece, and of the edges that join them."""
    of_piece = np.flatnonzero(scene_map.joined.piece == piece).tolist()
    tracks = {r: T[:, :3, 3] for r, T in enumerate(map_trajectories(scene_map)) if r in of_piece}
    everything = np.concatenate(list(tracks.values()))
    at = scene_map.joined.T_world_cam[:, :3, 3]
    of_part = scene_map.of_part
    edges = scene_map.joined.edges.pairs
    edges = edges[np.isin(of_part[edges[:, 0]], of_piece)]
    charts = []
    for title, (a, b, sign) in CAMERA_VIEWS.items():
        chart = Chart(title, limits(everything[:, a]), limits(sign * everything[:, b]), "m", "m", equal=True)
        for i, j in edges[:: max(len(edges) // MOST_JOINS, 1)].tolist():
            chart.line(at[[i, j], a], sign * at[[i, j], b], "join")
        for number, p in tracks.items():
            part = scene_map.parts[number]
            chart.line(p[:, a], sign * p[:, b], f"track track{number % COLOURS}")
            tips = [f"{part.name}, frame {frame}" for frame in part.frame[part.keyframe].tolist()]
            key = part.keyframe
            chart.dots(p[key, a], sign * p[key, b], f"dot track{number % COLOURS}", tips)
        charts.append(chart)
    return charts
