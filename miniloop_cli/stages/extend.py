"""Stage: a recording added to a map: what it touches is judged and adjusted, and the whole only if it must be."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace

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
from miniloop_cli.mapping.pieces import by_size, in_the_first_world
from miniloop_cli.mapping.retrieval import extended
from miniloop_cli.mapping.tracks import agreeing, extended_tracks, matched_again, near_pairs
from miniloop_cli.refinement.joint import untied
from miniloop_cli.refinement.tracks import Tracks
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.scene_map import Joined, MapPart, MapPoints, SceneMap, recording_of_keyframes
from miniloop_cli.stages.join import join
from miniloop_cli.stages.keyframes import common_scans
from miniloop_cli.stages.placing import MustAdjustAll, Placed, placed_in
from miniloop_cli.stages.run import Run
from miniloop_cli.stages.solve_between import solve_between
from miniloop_cli.typing import Bools, Floats, Ints, Pair

LOG = logging.getLogger("miniloop")
MAX_SURPRISE = 22.5  # chi-squared of 6 degrees of freedom: one keyframe in a thousand moves by more
MOVED_M, MOVED_DEG = 0.01, 0.5  # from where on keyframes may match otherwise: a third of the window of guided matching


def extend(before: SceneMap, part: MapPart, settings: Settings, run: Run) -> SceneMap:
    """The map with one more recording.

    Where the recording shows one piece of the map, its keyframes and those that share points with them are adjusted
    while the others are held; then all of the piece for a few steps. Where that moves a keyframe by more than the map
    thought possible, or the recording joins pieces, or the piece was never adjusted as one, all keyframes are adjusted
    again, as `join` does.
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
    """How the recordings lie to each other. Raises MustAdjustAll."""
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
    tracks = _tracks(old.landmarks, T, placed, part.edges, new, inside, scans, settings, run)
    T[inside], covariance[new] = _adjusted(T, covariance, old.landmarks, tracks, inside, new, scans, settings, run)
    T[inside] = in_the_first_world(T[inside], parts[int(of_part[np.argmax(inside)])])
    piece = by_size(np.append(old.piece, placed.piece), of_part)
    edges = EdgeTable.concatenated([old.edges, placed.edges])
    seen = landmarks(scans.points, T, tracks)
    return replace(old, T_world_cam=T, covariance=covariance, piece=piece, edges=edges, landmarks=seen)


def _tracks(
    known: MapPoints,
    T: Floats,
    placed: Placed,
    own: EdgeTable,
    new: Bools,
    inside: Bools,
    scans: ScanSet,
    settings: Settings,
    run: Run,
) -> Tracks:
    """Tracks of the map through the new keyframes, by what matches where the edges put them; `own`: their own edges."""
    first = int(np.argmax(new))
    edges = EdgeTable.concatenated([replace(own, i=own.i + first, j=own.j + first), placed.edges])
    tracks = extended_tracks(known, scans.first_feature, edges.pairs, _inliers(edges))
    seen = Observations.of(tracks, scans, 2)
    T = adjusted_locally(
        T, seen.subset(inside[seen.frame]), new, scans, settings.bundle, run.workers.threads
    ).T_world_cam
    near = near_pairs(T, np.concatenate([placed.near, np.flatnonzero(new)]), scans, settings.bundle)
    pairs = np.array([pair for pair in near if new[pair[1]]], np.int64).reshape(-1, 2)
    matches = matched_again(T, [(int(i), int(j)) for i, j in pairs], scans, settings.bundle, run.workers)
    tracks = extended_tracks(known, scans.first_feature, pairs, matches)
    return agreeing(tracks, landmarks(scans.points, T, tracks), scans.first_feature)


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

    Raises MustAdjustAll where the new ones are not tied to the map, or it moves by more than it thought possible.
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
