"""Stage: add a recording to a map; its neighbourhood is judged and adjusted, and the whole map only if necessary."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from miniloop_cli.config import Settings
from miniloop_cli.geometry import se3
from miniloop_cli.mapping.adjustment import (
    Observations,
    added_uncertainty,
    adjusted_locally,
    adjusted_together,
    covariance_beside_the_map,
    known_points,
    shared_tracks,
    surprise,
)
from miniloop_cli.mapping.landmarks import landmarks
from miniloop_cli.mapping.pieces import (
    as_one_table,
    by_size,
    in_the_first_world,
    moved_onto,
    pieces_of,
    whole_recordings,
)
from miniloop_cli.mapping.retrieval import extended
from miniloop_cli.mapping.tracks import extended_tracks, matched_again, near_pairs
from miniloop_cli.refinement.joint import untied
from miniloop_cli.refinement.tracks import Tracks
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.scene_map import Joined, MapPart, MapPoints, SceneMap, recording_of_keyframes
from miniloop_cli.stages.join import join
from miniloop_cli.stages.keyframes import common_scans, photometric_check
from miniloop_cli.stages.run import Run
from miniloop_cli.stages.solve_between import solve_between
from miniloop_cli.typing import Bools, Floats, Ints, Pair
from miniloop_cli.verification.consensus import average_verified

LOG = logging.getLogger("miniloop")
MAX_SURPRISE = 22.5  # chi-squared of 6 degrees of freedom: one keyframe in a thousand moves by more
MOST_TOUCHED = 0.5  # share of a piece that the new recording shows; beyond, adjusting all costs about the same
MOVED_M, MOVED_DEG = 0.01, 0.5  # with larger moves, matches may change: a third of the window of guided matching


class MustAdjustAll(Exception):
    """Why more than the neighbourhood of the new recording must be adjusted."""


class Placed(NamedTuple):
    """New keyframes in one piece of a map.

    T_new (k, 4, 4) in the world of `piece`; `near` (m,) keyframes of the map around them; verified `edges`, numbered
    through the map.
    """

    T_new: Floats
    piece: int
    near: Ints
    edges: EdgeTable


def extend(before: SceneMap, part: MapPart, settings: Settings, run: Run) -> SceneMap:
    """The map with one more recording.

    If the recording shows one piece of the map, its keyframes and those that share points with them are adjusted while
    the others are fixed; then the whole piece for a few steps. If that moves a keyframe by more than its uncertainty
    allows, or if the recording joins pieces, or if the piece was never adjusted as a whole, all keyframes are adjusted
    again as by `join`.
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
    placed = _placed(before, part, scans, solved, settings, run)
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
    pairs = near_pairs(T, np.concatenate([placed.near, np.flatnonzero(new)]), scans, settings.bundle)
    pairs = [pair for pair in pairs if new[pair[1]]]
    tracks = extended_tracks(
        old.landmarks,
        scans.first_feature,
        np.array(pairs, np.int64),
        matched_again(T, pairs, scans, settings.bundle, run.workers),
    )
    T[inside], covariance[new] = _adjusted(T, covariance, old.landmarks, tracks, inside, new, scans, settings, run)
    T[inside] = in_the_first_world(T[inside], parts[int(of_part[np.argmax(inside)])])
    piece = by_size(np.append(old.piece, placed.piece), of_part)
    edges = EdgeTable.concatenated([old.edges, placed.edges])
    seen = landmarks(scans.points, T, tracks)
    return replace(old, T_world_cam=T, covariance=covariance, piece=piece, edges=edges, landmarks=seen)


def _placed(
    before: SceneMap, part: MapPart, scans: ScanSet, solved: Mapping[Pair, EdgeTable], settings: Settings, run: Run
) -> Placed | None:
    """The keyframes of the recording in the map; None if it shows none of its pieces. Raises MustAdjustAll.

    Averaging and judging use its edges, and those of the matched keyframes of the map and of their neighbours.
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
    chosen = np.concatenate([near, np.arange(n, len(scans))])
    edges = EdgeTable.concatenated([own, before.joined.edges, between])
    edges = edges.subset(np.isin(edges.i, chosen) & np.isin(edges.j, chosen))
    edges = replace(edges, i=np.searchsorted(chosen, edges.i), j=np.searchsorted(chosen, edges.j))
    some = common_scans(parts, chosen)
    looks = settings.averaging.min_photo_consistency > 0
    photometric = photometric_check(parts, some, settings, run, chosen) if looks else None
    poses, edges = average_verified(edges, len(chosen), settings.averaging, photometric)

    is_new = chosen >= n
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


def _adjusted(
    T: Floats,
    covariance: Floats,
    known: MapPoints,
    tracks: Tracks,
    inside: Bools,
    new: Bools,
    scans: ScanSet,
    settings: Settings,
    run: Run,
) -> tuple[Floats, Floats]:
    """Poses (m, 4, 4) of the keyframes `inside` a piece (K,), covariances (k, 6, 6) of the `new` ones among them (K,).

    Raises MustAdjustAll if few points join the new ones to the map, or if it moves by more than its uncertainty allows.
    """
    seen = Observations.of(tracks, scans, settings.bundle.min_frames)
    seen = seen.subset(inside[seen.frame])
    if np.intersect1d(untied(seen.track, seen.frame, inside), np.flatnonzero(new)).size:
        raise MustAdjustAll("few points tie the new keyframes to it")
    jobs = run.workers.threads
    local = adjusted_locally(T, seen, new, scans, settings.bundle, jobs)
    LOG.info("%d keyframes of the map share points with the new ones", int((local.active & ~new).sum()))
    points = known_points(known, tracks, scans.first_feature)[: len(local.points)]
    points = np.where(np.isfinite(local.points), local.points, points)
    fixed = int(np.where(inside & ~new, np.einsum("kii->k", covariance), np.inf).argmin())
    after, points = adjusted_together(local.T_world_cam, points, seen, fixed, scans, settings.bundle, jobs)
    old = np.flatnonzero(inside & ~new)
    angle_deg, distance_m = se3.angle_and_distance(se3.inverse(T[old]) @ after[old])
    moved = surprise(T[old], after[old], covariance[old])
    LOG.info("keyframes of the map move by up to %.2f cm and %.2f deg", 100 * distance_m.max(), angle_deg.max())
    far = (moved > MAX_SURPRISE) & ((distance_m > MOVED_M) | (angle_deg > MOVED_DEG))
    if far.any():
        cm, sigmas = 100 * distance_m[far].max(), np.sqrt(moved[far].max())
        raise MustAdjustAll(f"{far.sum()} keyframes move by up to {cm:.1f} cm, {sigmas:.0f} standard deviations")
    base = int(np.where(new, 0, shared_tracks(seen, new)).argmax())
    own = covariance_beside_the_map(after, points, seen, new, scans, settings.bundle, jobs)
    return after[inside], own + added_uncertainty(after[new], covariance[base], after[base])


def _inliers(edges: EdgeTable) -> list[Ints]:
    return [edges.inlier_rows(e) for e in range(len(edges))]
