"""The 3D view of a map of several recordings: one scene of all, with the edges that join them."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.upward import up_direction
from miniloop_cli.mapping.carry import map_trajectories
from miniloop_cli.report.charts import named
from miniloop_cli.report.spacing import evenly_spaced
from miniloop_cli.report.truth import against_truth
from miniloop_cli.report.viewer import packing
from miniloop_cli.report.viewer.map_pieces import set_down
from miniloop_cli.report.viewer.matches import MOST_OF_EDGE, pack_matches, unpack_matches
from miniloop_cli.report.viewer.scene import rounded, scene
from miniloop_cli.results.columns import ReportData, load
from miniloop_cli.results.folder import Results
from miniloop_cli.results.map_files import CLOUD
from miniloop_cli.results.ply import read_ply
from miniloop_cli.results.recording import reopened
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import residuals
from miniloop_cli.scene.scene_map import MapPart, SceneMap
from miniloop_cli.scene.verdict import Verdict
from miniloop_cli.typing import Bytes, Floats, Ints

NOT_USED = "it was solved, but the map does not use it: other edges or the images contradict it"
SHARED = ("solvers", "solver_words", "verdicts", "packed", "left_out")  # of edges: not a column

Values = dict[str, Any]


@dataclass(frozen=True)
class MapData:
    """A map with the folder of each recording; T_shown (r, 4, 4): from its world to the view."""

    name: str
    content: SceneMap
    runs: tuple[ReportData, ...]
    T_shown: Floats

    @property
    def first(self) -> Ints:
        """(r + 1,) number of the first frame of each recording, counted through the map, and how many there are."""
        return np.cumsum([0, *(len(run.frames) for run in self.runs)])


def load_map(result: Path, content: SceneMap, with_images: bool = True) -> MapData:
    """Read the folders of the recordings. Raises InputError if a file in one is malformed."""
    runs = []
    for part in content.parts:
        folder = result / part.name
        runs.append(load(folder, reopened(Results(folder))[0] if with_images else None))
    shown = set_down(map_trajectories(content), content.joined.piece)
    return MapData(result.resolve().name, content, tuple(runs), shown)


def cloud_files(data: MapData, result: Path) -> list[tuple[Path, Floats]]:
    """The map's cloud, and those of recordings that are not joined to it, each with (4, 4) to the view."""
    files: list[tuple[Path, Floats]] = [(result / CLOUD, np.eye(4))]
    for part, piece, T in zip(data.content.parts, data.content.joined.piece, data.T_shown, strict=True):
        if piece:
            files.append((result / part.name / CLOUD, T))
    return [(path, T) for path, T in files if path.is_file()]


def map_cloud(data: MapData, result: Path) -> tuple[NDArray[np.floating], Bytes]:
    """Points (n, 3) and colours (n, 3) of all clouds of the map. Raises InputError for a damaged one."""
    clouds = [(T, *read_ply(path)) for path, T in cloud_files(data, result)]
    if not clouds:
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    points = [se3.transform(T, p.astype(float)) for T, p, _ in clouds]
    return np.concatenate(points), np.concatenate([colors for _, _, colors in clouds])


def map_scene(data: MapData) -> Values:
    """As `scene` for one recording; frames are counted through the recordings, which `recordings` lists."""
    scenes = [_recording(data, r) for r in range(len(data.runs))]
    piece = data.content.joined.piece
    main = np.concatenate([T for r, T in enumerate(map_trajectories(data.content)) if piece[r] == 0])
    leveled = data.runs[int((piece == 0).argmax())].results.leveled  # the others are shown in the first one's world
    truth = [one["truth"] or [None] * len(one["frames"]["pose"]) for one in scenes]
    return {
        "name": data.name,
        "up": rounded(up_direction(main, leveled), 6),
        "camera": scenes[0]["camera"],
        "recordings": [
            {"name": part.name, "first": int(first), "count": len(run.frames), "camera": one["camera"]}
            for part, first, run, one in zip(data.content.parts, data.first, data.runs, scenes, strict=False)
        ],
        "frames": {key: [v for one in scenes for v in one["frames"][key]] for key in scenes[0]["frames"]},
        "edges": _edges(data, [one["edges"] for one in scenes]),
        "truth": [v for positions in truth for v in positions] if any(one["truth"] for one in scenes) else None,
    }


def _recording(data: MapData, r: int) -> Values:
    """The scene of one recording in the view; its frames in separate pieces are left out."""
    run, T_shown = data.runs[r], data.T_shown[r]
    has_poses = (run.results.root / "trajectory.txt").is_file()
    shown = scene(run, against_truth(run, run.results.trajectory if has_poses else None))
    frames, piece = shown["frames"], int(data.content.joined.piece[r])
    for k, own in enumerate(frames["piece"]):
        if own != 0:
            frames["pose"][k], frames["piece"][k], frames["ellipsoid"][k] = None, -1, None
            continue
        frames["piece"][k] = piece
        if piece:
            T = T_shown @ se3.from_rows(np.array([frames["pose"][k]]))
            frames["pose"][k] = rounded(se3.to_rows(T)[0], 6)
            frames["ellipsoid"][k] = None
    if piece and shown["truth"]:
        shown["truth"] = [p and rounded(se3.transform(T_shown, np.array([p]))[0], 5) for p in shown["truth"]]
    return shown


def _edges(data: MapData, own: Sequence[Values]) -> Values:
    """The edges of all recordings, and those between recordings."""
    joins = [_between(data, a, b, table) for (a, b), table in sorted(data.content.joined.solved.items())]
    solvers = sorted({name for edges in (*own, *joins) for name in edges["solvers"]})
    numbered = [(edges, int(data.first[r])) for r, edges in enumerate(own)] + [(edges, 0) for edges in joins]
    columns: Values = {key: [] for key in own[0] if key not in SHARED}
    packed = []
    for edges, first in numbered:
        for key, column in columns.items():
            if key in ("i", "j"):
                column.extend(k + first for k in edges[key])
            elif key == "solver":
                column.extend(solvers.index(edges["solvers"][k]) for k in edges[key])
            else:
                column.extend(edges[key])
        packed.append(unpack_matches(base64.b64decode(edges["packed"])))
    matches = pack_matches(np.concatenate([px for px, _ in packed]), np.concatenate([agrees for _, agrees in packed]))
    return columns | {
        "solvers": solvers,
        "solver_words": [named(name) for name in solvers],
        "verdicts": own[0]["verdicts"],
        "packed": packing.text(matches),
        "left_out": sum(edges["left_out"] for edges in own),
    }


def _between(data: MapData, a: int, b: int, table: EdgeTable) -> Values:
    """The edges between two recordings as columns, by frames counted through the map."""
    content = data.content
    parts, n = (content.parts[a], content.parts[b]), len(content.parts[a])
    key_i, key_j = table.i, table.j - n
    i = data.first[a] + parts[0].frame[parts[0].keyframe[key_i]]
    j = data.first[b] + parts[1].frame[parts[1].keyframe[key_j]]
    T = np.concatenate([content.joined.T_world_cam[content.keyframes_of(r)] for r in (a, b)])
    deg, m = residuals(table, T)
    together = content.joined.piece[a] == content.joined.piece[b]
    numbers = np.stack([content.first[a] + key_i, content.first[b] + key_j], axis=1)
    used = set(map(tuple, content.joined.edges.pairs.tolist()))
    verified = [pair in used for pair in map(tuple, numbers.tolist())]
    drawn = [_matches(parts, table, e, int(key_i[e]), int(key_j[e])) for e in range(len(table))]
    px = np.concatenate([np.zeros((0, 4), np.uint16), *drawn])
    labels = [verdict.label for verdict in Verdict]
    solvers = sorted(set(table.solver.tolist()))
    return {
        "i": i.tolist(),
        "j": j.tolist(),
        "solvers": solvers,
        "solver": [solvers.index(name) for name in table.solver.tolist()],
        "verdict": [labels.index("verified" if own else "rejected") for own in verified],
        "rejection": [""] * len(table),
        "reason": ["" if own else NOT_USED for own in verified],
        "cycle": [str(number) if number >= 0 else "" for number in table.cycle.tolist()],
        "matches": [None] * len(table),  # only inliers are stored
        "inliers": table.inlier_count.tolist(),
        "deg": rounded(deg, 3) if together else [None] * len(table),
        "m": rounded(m, 5) if together else [None] * len(table),
        "drawn": [len(rows) for rows in drawn],
        "packed": packing.text(pack_matches(px, np.ones(len(px), bool))),
        "left_out": 0,
    }


def _matches(parts: tuple[MapPart, MapPart], table: EdgeTable, e: int, i: int, j: int) -> Any:
    """(c, 4) whole measured pixels of some matches of an edge."""
    rows = table.inlier_rows(e)
    rows = rows[evenly_spaced(len(rows), MOST_OF_EDGE)]
    ends = [
        part.camera.distort(part.features[key].px_ideal[rows[:, side]])
        for side, (part, key) in enumerate(zip(parts, (i, j), strict=True))
    ]
    px = np.nan_to_num(np.concatenate(ends, axis=1))
    return np.rint(np.clip(px, 0, 65535)).astype(np.uint16)
