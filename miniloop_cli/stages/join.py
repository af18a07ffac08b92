"""Stage: recordings that were registered by themselves, joined to one map where they show the same places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from miniloop_cli.averaging.optimum import prove_optimum
from miniloop_cli.config import Settings
from miniloop_cli.features.retrieval import around
from miniloop_cli.mapping.alone import landmarks_of
from miniloop_cli.mapping.common_camera import features_in, pinhole, view_in
from miniloop_cli.mapping.pieces import as_one_table, in_the_first_world, pieces_of, whole_recordings
from miniloop_cli.mapping.retrieval import index, most_similar
from miniloop_cli.refinement.inputs import Scans
from miniloop_cli.runtime.artifact_store import Arrays, content_fingerprint, fingerprint
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.extracted_scan import ExtractedScan
from miniloop_cli.scene.poses import Poses, usable_edges
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.scene_map import Joined, MapPart, SceneMap
from miniloop_cli.scene.sequence import Sequence as Recording
from miniloop_cli.stages.artifacts import JOINED, REPETITION
from miniloop_cli.stages.candidates import comparer
from miniloop_cli.stages.run import Run
from miniloop_cli.stages.solve_edges import solve_edges
from miniloop_cli.typing import Floats, Pair
from miniloop_cli.verification.consensus import average_verified
from miniloop_cli.verification.photometric_check import PhotometricCheck
from miniloop_cli.verification.repetition import pattern_steps_m

MOST_COMPARED = 10  # keyframes of another recording that each is compared with


def join(parts: Sequence[MapPart], settings: Settings, run: Run, known: Mapping[Pair, EdgeTable]) -> SceneMap:
    """The map of these recordings.

    `known`: edges between recordings that were solved before, by their numbers in `parts`; the others are solved now.
    The result depends on the recordings and their order alone, not on what was known.
    """
    solved = {
        (a, b): known[a, b] if (a, b) in known else solve_between(parts[a], parts[b], settings, run)
        for a, b in combinations(range(len(parts)), 2)
    }
    scans = common_scans(parts)
    edges = as_one_table([len(part) for part in parts], [part.edges for part in parts], solved)
    photometric = _photometric_check(parts, scans, settings, run) if settings.averaging.min_photo_consistency else None
    poses, edges = average_verified(edges, len(scans), settings.averaging, photometric)
    poses, _ = prove_optimum(poses, edges, settings.averaging)
    first = np.cumsum([0, *(len(part) for part in parts)])
    of_part = np.repeat(np.arange(len(parts)), np.diff(first))
    between = of_part[edges.i] != of_part[edges.j]
    piece = pieces_of(edges.subset(edges.verified & between), of_part, len(parts), poses.component)
    T = np.concatenate([part.T_world_key for part in parts])
    covariance = np.concatenate([part.covariance[part.keyframe] for part in parts])
    for number in range(piece.max(initial=-1) + 1):
        inside = np.flatnonzero(piece[of_part] == number)
        if len(np.unique(of_part[inside])) < 2:
            continue  # a recording by itself stays as it was registered
        start = whole_recordings(T, poses, inside, of_part)
        T[inside], covariance[inside] = _refined(start, edges, scans, inside, settings, run)
        T[inside] = in_the_first_world(T[inside], parts[int(of_part[inside[0]])])
    used = edges.subset(edges.verified & between & (piece[of_part[edges.i]] == piece[of_part[edges.j]]))
    seen = landmarks_of(parts, T, used)
    found = index([f for part in parts for f in part.features], parts[0].feature_type, len(parts[0]))
    joined = Joined(T, covariance, piece, solved, used, seen, found)
    return SceneMap(tuple(parts), joined, settings.model_dump(), run.seed)


def common_scans(parts: Sequence[MapPart]) -> ScanSet:
    """All keyframes as one set of scans, seen by the pinhole of the first recording's camera."""
    common = pinhole(parts[0].camera)
    extracted = [
        ExtractedScan(features_in(f, part.camera, common), view_in(view, part.camera, common), np.nan, np.nan, "")
        for part in parts
        for f, view in zip(part.features, part.views, strict=True)
    ]
    recording = Recording("map", Path(), common, ())
    return ScanSet(recording, extracted, parts[0].feature_type, fingerprint([part_key(part) for part in parts]))


def part_key(part: MapPart) -> str:
    """A name for what a recording's keyframes show."""
    own = [array for f in part.features for array in (f.px_ideal, f.z_m, f.descriptors)]
    return fingerprint(part.feature_type, replace(part.camera, source=""), content_fingerprint(own))


def solve_between(a: MapPart, b: MapPart, settings: Settings, run: Run) -> EdgeTable:
    """Edges between keyframes of two recordings (those of b are numbered after those of a), solved and judged.

    Compared are keyframes that look most alike, in either direction, then those around pairs that match. Kept are edges
    that were not rejected, with their inliers only.
    """
    scans, n = common_scans([a, b]), len(a)
    retrieval = index([*a.features, *b.features], a.feature_type, n)
    forth = {
        (i, n + int(j))
        for i in range(n)
        for j in most_similar(retrieval.vectors[n:], retrieval.vectors[i], MOST_COMPARED)
    }
    back = {
        (int(i), n + j)
        for j in range(len(b))
        for i in most_similar(retrieval.vectors[:n], retrieval.vectors[n + j], MOST_COMPARED)
    }
    compare = comparer(scans, settings.matching, run.workers)
    pairs = sorted(forth | back)
    matches = compare(pairs)
    near = {(i, j) for i, j in around(matches, len(scans)) if i < n <= j} - set(pairs)
    matches |= compare(sorted(near))
    # Every edge leads from one recording to the other, so that cycles have even lengths: odd ones are not looked for.
    even = settings.cycles.model_copy(update={"longest": settings.cycles.longest // 2 * 2})
    edges = solve_edges(matches, scans, settings.estimation._replace(cycles=even), run)
    return edges.subset(edges.open).inliers_only().rounded()


def _photometric_check(parts: Sequence[MapPart], scans: ScanSet, settings: Settings, run: Run) -> PhotometricCheck:
    """What the keyframes show beside their matches; how each repeats itself is kept by recording."""
    steps = []
    for part in parts:
        alone = common_scans([part])

        def make(alone: ScanSet = alone) -> Arrays:
            return {
                "step_m": np.array(pattern_steps_m(alone, settings.ransac, settings.verification.chi2, run.workers))
            }

        key = (alone.key, settings.ransac, settings.verification.chi2)
        steps.append(run.store.cached(REPETITION, key, make)["step_m"])
    outline = [features.outline for features in scans.features]
    return PhotometricCheck(scans.thumbnails, scans.points, outline, np.concatenate(steps), scans.camera)


def _refined(
    T_world_cam: Floats, edges: EdgeTable, scans: ScanSet, inside: np.ndarray, settings: Settings, run: Run
) -> tuple[Floats, Floats]:
    """Poses (m, 4, 4) and covariances (m, 6, 6) of the keyframes of one piece, refined together from those given.

    Their measurements are as if taken at one instant each, so that there is no motion to undo.
    """
    poses = Poses(T_world_cam, np.where(np.isin(np.arange(len(scans)), inside), 0, 1))
    usable = edges.subset(usable_edges(edges, len(scans)) & poses.joins(edges))
    bundle = settings.bundle.model_copy(update={"timing": False, "motion": False})

    def make() -> Arrays:
        from miniloop_cli.refinement.joint import refine_jointly

        stamps_s = np.linspace(0.0, 1000.0 * len(scans), len(scans))  # so far apart that no path joins them
        inputs = Scans(scans.features, scans.points, stamps_s, stamps_s, scans.camera, scans.feature_type)
        found = refine_jointly(poses, usable, inputs, settings.refine, bundle, run.workers)
        return {"T_world_cam": found.poses.T_world_cam, "covariance": found.covariance}

    key = (scans.key, poses, usable, settings.refine, bundle)
    kept = run.store.cached(JOINED, key, make) if settings.refine != "none" else {"T_world_cam": T_world_cam}
    covariance = kept.get("covariance", np.full((len(scans), 6, 6), np.nan))
    return kept["T_world_cam"][inside], covariance[inside]
