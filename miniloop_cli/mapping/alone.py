"""The map of one recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from miniloop_cli.mapping.landmarks import landmarks
from miniloop_cli.mapping.retrieval import index
from miniloop_cli.refinement.tracks import build_tracks
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.points import scan_points
from miniloop_cli.scene.scene_map import Joined, MapPart, MapPoints, SceneMap, first_keyframes
from miniloop_cli.typing import Floats, Ints


def map_of(part: MapPart, settings: Mapping[str, Any], seed: int) -> SceneMap:
    """The map of a recording by itself, in its own world."""
    T, covariance = part.T_world_key, part.covariance[part.keyframe]
    seen = landmarks_of([part], T, EdgeTable.of([]))
    found = index(part.features, part.feature_type, len(part))
    joined = Joined(T, covariance, np.zeros(1, np.int64), {}, EdgeTable.of([]), seen, found)
    return SceneMap((part,), joined, settings, seed)


def landmarks_of(parts: Sequence[MapPart], T_world_cam: Floats, between: EdgeTable) -> MapPoints:
    """Points seen by keyframes of these recordings at T_world_cam (K, 4, 4); `between`: edges that join them."""
    points = [scan_points(features, part.camera) for part in parts for features in part.features]
    pairs, matches = matches_of_edges(parts, between)
    offsets = np.cumsum([0, *(len(scan.points_m) for scan in points)])
    return landmarks(points, T_world_cam, build_tracks(offsets, pairs, matches))


def matches_of_edges(parts: Sequence[MapPart], between: EdgeTable) -> tuple[Ints, list[Ints]]:
    """Pairs (m, 2) of keyframes, counted through the recordings, and the inliers (k, 2) of each edge."""
    first = first_keyframes(parts)
    pairs = [part.edges.pairs + start for part, start in zip(parts, first, strict=False)]
    tables = [*(part.edges for part in parts), between]
    return np.concatenate([*pairs, between.pairs]), [
        table.inlier_rows(e) for table in tables for e in range(len(table))
    ]
