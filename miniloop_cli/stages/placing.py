"""Stage: the first poses of a new recording in a map, from its edges to the keyframes there."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from miniloop_cli.config import Settings
from miniloop_cli.geometry import se3
from miniloop_cli.mapping.pieces import as_one_table, moved_onto, pieces_of, whole_recordings
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.scene_map import MapPart, SceneMap, recording_of_keyframes
from miniloop_cli.stages.average import photometric_check
from miniloop_cli.stages.keyframes import common_scans
from miniloop_cli.stages.run import Run
from miniloop_cli.typing import Floats, Ints, Pair
from miniloop_cli.verification.consensus import average_verified

LOG = logging.getLogger("miniloop")
MOVED_M, MOVED_DEG = 0.01, 0.5  # matches may change beyond a third of the window of guided matching
ROUNDING_M = 1e-6  # a pose that was held differs by less
MOST_TOUCHED = 0.5  # share of a piece that the new recording shows; beyond, adjusting all costs no more


class MustAdjustAll(Exception):
    """Why more than the neighbourhood of the new recording must be adjusted."""


class Placed(NamedTuple):
    """New keyframes beside those of one piece of a map.

    T_new (k, 4, 4) in the world of `piece`; `near` (m,) keyframes of the map around them; `edges` that were verified,
    numbered through the map.
    """

    T_new: Floats
    piece: int
    near: Ints
    edges: EdgeTable


def placed_in(
    before: SceneMap, part: MapPart, solved: Mapping[Pair, EdgeTable], settings: Settings, run: Run
) -> Placed | None:
    """The keyframes of the recording in the map; None if it shows none of its pieces. Raises MustAdjustAll.

    Averaged and judged are its edges with those of the keyframes of the map that it was matched with, and of their
    neighbours.
    """
    parts, last, n = (*before.parts, part), len(before.parts), int(before.first[-1])
    counts = [len(one) for one in parts]
    of_part = recording_of_keyframes(parts)
    old_piece = np.append(before.joined.piece, -1)[of_part]  # of each keyframe
    own = as_one_table(counts, [one.edges for one in parts], {})
    between = as_one_table(counts, [], {pair: edges for pair, edges in solved.items() if pair[1] == last})
    touched = np.unique(between.i)
    inner = np.concatenate([own.pairs[own.verified], before.joined.edges.pairs])
    near = np.union1d(touched, inner[np.isin(inner, touched).any(axis=1)])
    near = near[near < n]
    chosen = np.concatenate([near, np.arange(n, int(before.first[-1]) + len(part))])
    tables = (own, before.joined.edges, between)
    inside = [one.subset(np.isin(one.i, chosen) & np.isin(one.j, chosen)) for one in tables]
    edges = EdgeTable.concatenated(inside)
    edges = replace(edges, i=np.searchsorted(chosen, edges.i), j=np.searchsorted(chosen, edges.j))
    is_new = chosen >= n
    compared = is_new[edges.i] == is_new[edges.j]  # those between the recording and the map were not
    some = common_scans(parts, chosen)
    looks = settings.averaging.min_photo_consistency > 0
    photometric = photometric_check(some, settings.ransac, settings.verification.chi2, run) if looks else None
    poses, edges = average_verified(edges, len(chosen), settings.averaging, photometric, run.workers.threads, compared)

    added = edges.subset(edges.verified & ~is_new[edges.i] & is_new[edges.j])
    label = pieces_of(added, of_part[chosen], len(parts), poses.component)
    shown = np.unique(before.joined.piece[np.flatnonzero(label[:last] == label[last])])
    if not len(shown):
        return None
    if len(shown) > 1:
        raise MustAdjustAll(f"{part.name} joins {len(shown)} pieces of it")
    piece = int(shown[0])
    if np.count_nonzero(before.joined.piece == piece) < 2:
        raise MustAdjustAll("its recordings were not adjusted together before")
    of_piece = np.count_nonzero(old_piece == piece)
    shared = np.count_nonzero(old_piece[chosen[np.unique(added.i)]] == piece)
    if shared > MOST_TOUCHED * of_piece:
        raise MustAdjustAll(f"{part.name} shows what {shared} of {of_piece} keyframes show")
    numbers = poses.component[is_new]
    main = np.bincount(numbers[numbers >= 0]).argmax()
    beside = np.flatnonzero((poses.component == main) & (old_piece[chosen] == piece))
    where = before.joined.T_world_cam[chosen[beside]]
    T = moved_onto(poses.T_world_cam[beside], where) @ poses.T_world_cam
    angle_deg, distance_m = se3.angle_and_distance(se3.inverse(where) @ T[beside])
    most = settings.averaging
    if (angle_deg > most.max_residual_deg).any() or (distance_m > most.max_residual_m).any():
        cm, deg = 100 * distance_m.max(), angle_deg.max()
        raise MustAdjustAll(f"by {part.name}, keyframes lie up to {cm:.0f} cm and {deg:.1f} deg elsewhere")
    T_own = np.tile(np.eye(4), (len(chosen), 1, 1))
    T_own[is_new] = part.T_world_key
    T = whole_recordings(T_own, Poses(T, poses.component), np.flatnonzero(is_new), of_part[chosen])
    added = replace(added, i=chosen[added.i], j=chosen[added.j])
    return Placed(T[is_new], piece, near[old_piece[near] == piece], added.subset(old_piece[added.i] == piece))


def require_map_as_it_is(name: str, T_before: Floats, T_after: Floats) -> None:
    """Raises MustAdjustAll if half of the keyframes of the map that moved, from (k, 4, 4) to (k, 4, 4), moved far.

    That happens when recording `name` closes a loop: the map bends, and its matches must be judged at other poses.
    """
    angle_deg, distance_m = se3.angle_and_distance(se3.inverse(T_before) @ T_after)
    moved = distance_m > ROUNDING_M
    if moved.any():
        deg, cm = np.median(angle_deg[moved]), 100 * np.median(distance_m[moved])
        LOG.debug("%d keyframes of the map that share points move by %.2f cm and %.2f deg", moved.sum(), cm, deg)
        if deg > MOVED_DEG or cm > 100 * MOVED_M:
            raise MustAdjustAll(f"{name} moves what it shows of it by {cm:.1f} cm and {deg:.1f} deg (median)")
