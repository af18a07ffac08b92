"""Stage: join recordings, each registered by itself, into one map by the places that they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from miniloop_cli.averaging.optimum import prove_optimum
from miniloop_cli.config import Settings
from miniloop_cli.mapping.adjustment import known_points, most_certain, settled
from miniloop_cli.mapping.alone import matches_of_edges
from miniloop_cli.mapping.landmarks import landmarks
from miniloop_cli.mapping.pieces import as_one_table, in_the_first_world, pieces_of, whole_recordings
from miniloop_cli.mapping.retrieval import index
from miniloop_cli.mapping.tracks import agreeing, matched_again, near_pairs
from miniloop_cli.refinement.inputs import Scans
from miniloop_cli.refinement.tracks import Tracks, build_tracks
from miniloop_cli.runtime.artifact_store import Arrays
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses, usable_edges
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.scene_map import Joined, MapPart, SceneMap, first_keyframes, recording_of_keyframes
from miniloop_cli.stages.artifacts import JOINED
from miniloop_cli.stages.average import photometric_check
from miniloop_cli.stages.keyframes import common_scans
from miniloop_cli.stages.run import Run
from miniloop_cli.stages.solve_between import solve_between
from miniloop_cli.typing import Floats, Ints, Pair
from miniloop_cli.verification.consensus import average_verified


def join(parts: Sequence[MapPart], settings: Settings, run: Run, known: Mapping[Pair, EdgeTable]) -> SceneMap:
    """The map of these recordings, with all of its keyframes adjusted together.

    `known`: already solved edges between recordings, by their numbers in `parts`; the others are solved here.
    """
    found = index([f for part in parts for f in part.features], parts[0].feature_type, len(parts[0]))
    first = first_keyframes(parts)
    solved = dict(known)
    for last in range(1, len(parts)):
        if any((a, last) not in known for a in range(last)):
            solved |= solve_between(parts[: last + 1], found.vectors[: first[last + 1]], settings, run)
    scans = common_scans(parts)
    edges = as_one_table([len(part) for part in parts], [part.edges for part in parts], solved)
    looks = settings.averaging.min_photo_consistency > 0
    photometric = photometric_check(scans, settings.ransac, settings.verification.chi2, run) if looks else None
    poses, edges = average_verified(edges, len(scans), settings.averaging, photometric, run.workers.threads)
    poses, _ = prove_optimum(poses, edges, settings.averaging)
    of_part = recording_of_keyframes(parts)
    between = of_part[edges.i] != of_part[edges.j]
    piece = pieces_of(edges.subset(edges.verified & between), of_part, len(parts), poses.component)
    T = np.concatenate([part.T_world_key for part in parts])
    covariance = np.concatenate([part.covariance[part.keyframe] for part in parts])
    for number in range(piece.max(initial=-1) + 1):
        inside = np.flatnonzero(piece[of_part] == number)
        if len(np.unique(of_part[inside])) < 2:
            continue  # a single recording keeps its poses
        start = whole_recordings(T, poses, inside, of_part)
        T[inside], covariance[inside] = _refined(start, edges, scans, inside, settings, run)
    used = edges.subset(edges.verified & between & (piece[of_part[edges.i]] == piece[of_part[edges.j]]))
    usable = edges.subset(edges.verified)
    tracks = _tracks(parts, T, piece[of_part], scans, usable, settings, run)
    seen = landmarks(scans.points, T, tracks)
    tracks = agreeing(tracks, seen, scans.first_feature)
    points = known_points(seen, tracks, scans.first_feature)
    for together in np.flatnonzero(np.bincount(piece) > 1):
        inside = piece[of_part] == together
        if settings.refine == "bundle":
            # The refinement stops where a step gains little. What is added later must find the map at rest.
            fixed = most_certain(covariance, inside)
            jobs = run.workers.threads
            T = settled(T, points, tracks, usable, inside, fixed, scans, settings.bundle, jobs).T_world_cam
        T[inside] = in_the_first_world(T[inside], parts[int(of_part[np.argmax(inside)])])
    seen = landmarks(scans.points, T, tracks)
    return SceneMap(
        tuple(parts), Joined(T, covariance, piece, solved, used, seen, found), settings.model_dump(), run.seed
    )


def _tracks(
    parts: Sequence[MapPart],
    T: Floats,
    piece: Ints,
    scans: ScanSet,
    edges: EdgeTable,
    settings: Settings,
    run: Run,
) -> Tracks:
    """Tracks of the map: for keyframes refined together, from guided matches at their poses, as in `extend`.

    piece (K,): of each keyframe; edges: all verified ones. Single recordings have the tracks of their own edges.
    """
    pairs, matches = matches_of_edges(parts, EdgeTable.of([]))
    of_part = recording_of_keyframes(parts)
    several = np.array([len(np.unique(of_part[piece == number])) > 1 for number in range(piece.max(initial=-1) + 1)])
    own = np.flatnonzero(~several[piece[pairs[:, 0]]])
    pairs, matches = pairs[own], [matches[e] for e in own]
    for number in np.flatnonzero(several):
        near = near_pairs(T, np.flatnonzero(piece == number), edges, scans, settings.bundle)
        pairs = np.concatenate([pairs, np.array(near, np.int64).reshape(-1, 2)])
        matches += matched_again(T, near, scans, settings.bundle, run.workers)
    return build_tracks(scans.first_feature, pairs, matches)


def _refined(
    T_world_cam: Floats, edges: EdgeTable, scans: ScanSet, inside: Ints, settings: Settings, run: Run
) -> tuple[Floats, Floats]:
    """Poses (m, 4, 4) and covariances (m, 6, 6) of the keyframes of one piece, refined together from given ones.

    Their measurements are corrected to one instant already, so there is no timing to correct.
    """
    poses = Poses(T_world_cam, np.where(np.isin(np.arange(len(scans)), inside), 0, 1))
    usable = edges.subset(usable_edges(edges, len(scans)) & poses.joins(edges))
    bundle = settings.bundle.model_copy(update={"timing": False, "motion": False})

    def make() -> Arrays:
        from miniloop_cli.refinement.joint import refine_jointly

        stamps_s = np.linspace(0.0, 1000.0 * len(scans), len(scans))  # far apart, so that there is no path between them
        inputs = Scans(scans.features, scans.points, stamps_s, stamps_s, scans.camera, scans.feature_type)
        found = refine_jointly(poses, usable, inputs, settings.refine, bundle, run.workers)
        return {"T_world_cam": found.poses.T_world_cam, "covariance": found.covariance}

    key = (scans.key, poses, usable, settings.refine, bundle)
    kept = run.store.cached(JOINED, key, make) if settings.refine != "none" else {"T_world_cam": T_world_cam}
    covariance = kept.get("covariance", np.full((len(scans), 6, 6), np.nan))
    return kept["T_world_cam"][inside], covariance[inside]
