"""Stage: add a recording to a map; its neighbourhood is judged and adjusted, and the whole map only if necessary."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from collections.abc import Sequence as Many
from dataclasses import replace

import numpy as np

from miniloop_cli.config import Settings
from miniloop_cli.geometry import se3
from miniloop_cli.mapping.adjustment import (
    AT_REST,
    NEARLY_AT_REST,
    Observations,
    Rest,
    Settled,
    added_uncertainty,
    adjusted_locally,
    covariance_beside_the_map,
    known_points,
    most_certain,
    moved_uncertainty,
    settled,
    shared_tracks,
)
from miniloop_cli.mapping.landmarks import landmarks
from miniloop_cli.mapping.pieces import as_one_table, by_size, in_the_first_world
from miniloop_cli.mapping.retrieval import extended
from miniloop_cli.mapping.tracks import agreeing, extended_tracks, matched_again, near_pairs, without_keyframes
from miniloop_cli.refinement.joint import MIN_SHARED
from miniloop_cli.refinement.tracks import Tracks
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.scene_map import Joined, MapPart, MapPoints, SceneMap, recording_of_keyframes
from miniloop_cli.stages.join import join
from miniloop_cli.stages.keyframes import common_scans
from miniloop_cli.stages.placing import MOVED_DEG, MOVED_M, MustAdjustAll, placed_in, require_map_as_it_is
from miniloop_cli.stages.run import Run
from miniloop_cli.stages.solve_between import solve_between
from miniloop_cli.typing import Bools, Floats, Ints, Pair

LOG = logging.getLogger("miniloop")


def extend(before: SceneMap, part: MapPart, settings: Settings, run: Run) -> SceneMap:
    """The map with one more recording.

    If the recording shows one piece of the map, its keyframes and those that share points with them are adjusted while
    the others are fixed; then the piece is adjusted until it rests. Keyframes of the map that this moves by more than
    MOVED_M or MOVED_DEG are matched again. All keyframes are adjusted again as by `join` if the recording joins pieces,
    bends the map or shows most of the piece, or if the piece was never adjusted as a whole.
    """
    parts = (*before.parts, part)
    retrieval = extended(before.joined.retrieval, part.features, part.feature_type)
    solved = {**before.joined.solved, **solve_between(parts, retrieval.vectors, settings, run)}
    try:
        joined = _extended(before, part, solved, settings, run)
    except MustAdjustAll as why:
        LOG.info("all keyframes of the map are adjusted again: %s", why)
        return join(parts, settings, run, solved)
    return SceneMap(parts, replace(joined, solved=solved, retrieval=retrieval), before.settings, before.seed)


def _extended(
    before: SceneMap, part: MapPart, solved: Mapping[Pair, EdgeTable], settings: Settings, run: Run
) -> Joined:
    """The relative poses of the recordings. Raises MustAdjustAll."""
    if settings.refine != "bundle":
        raise MustAdjustAll(f"refine is {settings.refine}")
    parts, old = (*before.parts, part), before.joined
    of_part = recording_of_keyframes(parts)
    new = of_part == len(parts) - 1
    scans = common_scans(parts)
    placed = placed_in(before, part, solved, settings, run)
    T = np.concatenate([old.T_world_cam, part.T_world_key])
    covariance = np.concatenate([old.covariance, part.covariance[part.keyframe]])
    if placed is None:
        piece = by_size(np.append(old.piece, old.piece.max() + 1), of_part)
        tracks = extended_tracks(
            old.landmarks, scans.first_feature, part.edges.pairs + int(np.argmax(new)), _inliers(part.edges)
        )
        return replace(
            old, T_world_cam=T, covariance=covariance, piece=piece, landmarks=landmarks(scans.points, T, tracks)
        )
    T[new] = placed.T_new
    inside = np.append(old.piece, placed.piece)[of_part] == placed.piece
    T_by_edges = _by_edges(T, old.landmarks, part.edges, placed.edges, inside, new, scans, settings, run)
    require_map_as_it_is(part.name, T[~new], T_by_edges[~new])
    T[new] = T_by_edges[new]
    fixed = most_certain(covariance, inside & ~new)
    own = as_one_table([len(one) for one in parts], [one.edges.subset(one.edges.verified) for one in parts], {})
    edges = EdgeTable.concatenated([own, old.edges, placed.edges])

    found, tracks = _at_rest(T, old.landmarks, edges, inside, new, fixed, scans, settings, run)
    T = found.T_world_cam
    base = int(np.where(new, 0, shared_tracks(found.seen, new)).argmax())
    beside = covariance_beside_the_map(found, new, scans, settings.bundle, run.workers.threads)
    covariance[new] = beside + added_uncertainty(T[new], covariance[base], T[base])
    T[inside] = in_the_first_world(T[inside], parts[int(of_part[np.argmax(inside)])])
    covariance[~new] += moved_uncertainty(old.T_world_cam, T[~new])
    piece = by_size(np.append(old.piece, placed.piece), of_part)
    between = EdgeTable.concatenated([old.edges, placed.edges])
    known = landmarks(scans.points, T, tracks)
    return replace(old, T_world_cam=T, covariance=covariance, piece=piece, edges=between, landmarks=known)


def _by_edges(
    T: Floats,
    known: MapPoints,
    own: EdgeTable,
    between: EdgeTable,
    inside: Bools,
    new: Bools,
    scans: ScanSet,
    settings: Settings,
    run: Run,
) -> Floats:
    """(K, 4, 4) poses by the matches of edges: the `own` ones of the recording, and those `between` it and the map.

    The `new` keyframes (K,) and those that share points with them move.
    """
    first = int(np.argmax(new))
    edges = EdgeTable.concatenated([replace(own, i=own.i + first, j=own.j + first), between])
    tracks = extended_tracks(known, scans.first_feature, edges.pairs, _inliers(edges))
    seen = Observations.of(tracks, scans, 2)
    seen = seen.subset(inside[seen.frame])
    return adjusted_locally(T, seen, new, scans, settings.bundle, run.workers.threads)


def _at_rest(
    T: Floats,
    known: MapPoints,
    edges: EdgeTable,
    inside: Bools,
    new: Bools,
    fixed: int,
    scans: ScanSet,
    settings: Settings,
    run: Run,
) -> tuple[Settled, Tracks]:
    """The piece at rest with its `new` keyframes (K,), and its tracks, from poses T (K, 4, 4) nearby.

    As long as matches may change, keyframes that are matched again are brought nearly to rest, and those that share
    points with them; then all to rest.
    """
    T_matched, again, far, jobs = T, new, new, run.workers.threads
    near = near_pairs(T, np.flatnonzero(inside), edges, scans, settings.bundle)

    def adjusted(points: Floats, active: Bools, rest: Rest) -> Settled:
        return settled(T, points, tracks, edges, inside, fixed, scans, settings.bundle, jobs, active, rest)

    def moved_far() -> Bools:
        angle_deg, distance_m = se3.angle_and_distance(se3.inverse(T_matched) @ T)
        far: Bools = inside & ~again & ((distance_m > MOVED_M) | (angle_deg > MOVED_DEG))
        cm, deg = 100 * distance_m[~new].max(), angle_deg[~new].max()
        LOG.info("keyframes of the map move by up to %.2f cm and %.2f deg; %d are matched again", cm, deg, far.sum())
        return far

    while far.any():
        again = again | far
        tracks, points = _tracks(known, T, near, again, scans, settings, run)
        seen = Observations.of(tracks, scans, settings.bundle.min_frames)
        found = adjusted(points, far | (shared_tracks(seen, far) >= MIN_SHARED), NEARLY_AT_REST)
        T, far = found.T_world_cam, moved_far()
        if not far.any():
            found = adjusted(found.points, inside, AT_REST)
            T, far = found.T_world_cam, moved_far()
    return found, tracks


def _tracks(
    known: MapPoints,
    T: Floats,
    near: Many[Pair],
    again: Bools,
    scans: ScanSet,
    settings: Settings,
    run: Run,
) -> tuple[Tracks, Floats]:
    """Tracks of the points of the map, and of new matches of the keyframes that are matched `again` (K,).

    near: pairs of keyframes that see the same.

    Also their points (tracks, 3), NaN where unknown.

    Some matches near the predicted positions are false. A few per cent of them bend a large map by centimetres, so
    those that contradict the points at the poses T (K, 4, 4) are left out.
    """
    pairs = [pair for pair in near if again[pair[0]] or again[pair[1]]]
    matches = matched_again(T, pairs, scans, settings.bundle, run.workers)
    rest = without_keyframes(known, again, scans.first_feature)
    tracks = extended_tracks(rest, scans.first_feature, np.array(pairs, np.int64).reshape(-1, 2), matches)
    seen = landmarks(scans.points, T, tracks)
    tracks = agreeing(tracks, seen, scans.first_feature)
    return tracks, known_points(seen, tracks, scans.first_feature)


def _inliers(edges: EdgeTable) -> list[Ints]:
    return [edges.inlier_rows(e) for e in range(len(edges))]
