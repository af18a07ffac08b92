"""Pictures of the model and of edges as JPEG files in memory, cached as other artefacts."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.report.images import jpeg, match_picture
from miniloop_cli.report.splat import overview, render
from miniloop_cli.results.ply import read_ply
from miniloop_cli.runtime.artifact_store import Arrays, Artifact, Store, file_fingerprint
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.typing import Bytes, Floats

PICTURES = Artifact("pictures", 2)
QUALITY = 65  # of the images in a page
FARTHEST_M = 1e6
VIEWS_DEG = ((0, 0), (25, 30))  # yaw, pitch
SIZE = (960, 640)
FEWEST_POINTS = 10


def model_pictures(cloud: Path, T_world_cam: Floats, store: Store) -> tuple[int, list[Bytes]]:
    """Number of points of a PLY file, and its pictures as JPEG, one for each of `VIEWS_DEG`; none of an empty cloud.

    `T_world_cam` (n, 4, 4): the cameras, whose mean direction is that of the first view. Raises InputError if the file
    cannot be read.
    """

    def drawn() -> Arrays:
        points, colors = read_ply(cloud)
        sane = (np.abs(points) < FARTHEST_M).all(axis=1)
        points, colors = points[sane], colors[sane]
        found = {"count": np.array([len(points)])}
        if len(points) >= FEWEST_POINTS:
            for k, (yaw_deg, pitch_deg) in enumerate(VIEWS_DEG):
                view = overview(points, T_world_cam, yaw_deg, pitch_deg, SIZE)
                found[f"view_{k}"] = jpeg(render(points, colors, view), QUALITY)
        return found

    kept = store.cached(PICTURES, ("model", file_fingerprint(cloud), T_world_cam), drawn)
    return int(kept["count"][0]), [kept[name] for name in sorted(kept) if name != "count"]


def edge_picture(sequence: Sequence, i: int, j: int, px_i: Floats, px_j: Floats, store: Store) -> Bytes | None:
    """Frames i, j with their inliers px_i, px_j (k, 2), measured pixels, joined, as JPEG; None if one is unreadable."""

    def drawn() -> Arrays:
        picture = match_picture(sequence, i, j, px_i, px_j)
        return {"jpeg": np.zeros(0, np.uint8) if picture is None else jpeg(picture, QUALITY)}

    if max(i, j) >= len(sequence.frames):
        return None
    files = [sequence.frames[k].color.fingerprint() for k in (i, j)]
    found = store.cached(PICTURES, ("edge", files, px_i, px_j), drawn)["jpeg"]
    return found if len(found) else None
