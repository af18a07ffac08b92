"""Tracks through the keyframes of a map: those of its points, extended by matches to new keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from miniloop_cli.config import Bundle
from miniloop_cli.features.guided import guided_matches
from miniloop_cli.geometry import se3
from miniloop_cli.graph.visibility import best_partners
from miniloop_cli.refinement.tracks import Tracks, build_tracks
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.scene_map import MapPoints
from miniloop_cli.typing import Bools, Floats, Ints, Pair

KNOWN = 1e9  # strength of a match of a point of the map, which new matches do not break


def matched_again(
    T_world_cam: Floats, pairs: Sequence[Pair], scans: ScanSet, settings: Bundle, workers: Workers
) -> list[Ints]:
    """Matches (k, 2) of each pair of keyframes near the positions predicted by their poses (K, 4, 4)."""
    i, j = np.array(pairs, np.int64).reshape(-1, 2).T
    T_j_i = se3.inverse(T_world_cam[j]) @ T_world_cam[i]
    return guided_matches(pairs, T_j_i, scans.features, scans.feature_type, scans.camera, settings, workers)


def near_pairs(T_world_cam: Floats, inside: Ints, edges: EdgeTable, scans: ScanSet, settings: Bundle) -> list[Pair]:
    """Pairs of the keyframes `inside` (k,) that see the same: by edges, then by the poses T_world_cam (K, 4, 4)."""
    return best_partners(T_world_cam, inside, scans.points, scans.camera, settings.partners, edges)


def matches_of_points(points: MapPoints, first_feature: Ints) -> tuple[Ints, list[Ints]]:
    """Pairs (m, 2) of keyframes and their matches (k, 2), which chain the observations of each point.

    first_feature (K + 1,): number of the first feature of each keyframe among all.
    """
    feature = np.flatnonzero(points.of_feature >= 0)
    feature = feature[np.argsort(points.of_feature[feature], kind="stable")]  # by point, then by keyframe
    frame = np.searchsorted(first_feature, feature, side="right") - 1
    number = points.of_feature[feature]
    step = np.flatnonzero(number[1:] == number[:-1])
    pairs = np.stack([frame[step], frame[step + 1]], axis=1)
    matches = np.stack([feature[step], feature[step + 1]], axis=1) - first_feature[pairs]
    order = np.lexsort(pairs.T[::-1])
    pairs, matches = pairs[order], matches[order]
    begins = np.flatnonzero(np.r_[True, (pairs[1:] != pairs[:-1]).any(axis=1)]) if len(pairs) else np.zeros(0, int)
    return pairs[begins], np.split(matches, begins[1:]) if len(pairs) else []


def without_keyframes(points: MapPoints, keyframes: Bools, first_feature: Ints) -> MapPoints:
    """The points as the other keyframes saw them; `keyframes` (K,) may be more than the points know.

    first_feature (K + 1,): number of the first feature of each keyframe among all.
    """
    lost = np.repeat(keyframes, np.diff(first_feature))[: len(points.of_feature)]
    return replace(points, of_feature=np.where(lost, -1, points.of_feature))


def extended_tracks(points: MapPoints, first_feature: Ints, pairs: Ints, matches: Sequence[Ints]) -> Tracks:
    """Tracks through all keyframes: those of the points, extended and joined by `matches` (k, 2) of new pairs (m, 2).

    first_feature (K + 1,): of all keyframes, the new ones after those of the map.
    """
    known, chains = matches_of_points(points, first_feature)
    strength = [KNOWN] * len(known) + [float(len(rows)) for rows in matches]
    return build_tracks(first_feature, np.concatenate([known, pairs.reshape(-1, 2)]), [*chains, *matches], strength)


def agreeing(tracks: Tracks, points: MapPoints, first_feature: Ints) -> Tracks:
    """The tracks without observations that contradict the points which were made of them; first_feature (K + 1,)."""
    kept = points.of_feature[first_feature[tracks.frame] + tracks.feature] >= 0
    return replace(tracks, frame=tracks.frame[kept], track=tracks.track[kept], feature=tracks.feature[kept])
