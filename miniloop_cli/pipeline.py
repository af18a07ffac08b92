"""The whole run: the stages in order, each from named inputs to named outputs, timed."""

from __future__ import annotations

import numpy as np

from miniloop_cli.averaging.components import beginning
from miniloop_cli.config import Settings
from miniloop_cli.features.detect import compact
from miniloop_cli.features.retrieval import DESCRIBED_FEATURES, around
from miniloop_cli.refinement.inputs import Scans
from miniloop_cli.runtime.artifact_store import Store, fingerprint
from miniloop_cli.runtime.parallel import Workers, single_inner_threads
from miniloop_cli.runtime.stopwatch import Stopwatch
from miniloop_cli.scene.edge import Edge
from miniloop_cli.scene.extracted_scan import ExtractedScan
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.points import Matches, ScanPoints, scan_points
from miniloop_cli.scene.priors import Priors
from miniloop_cli.scene.registration import Registration, RegistrationError
from miniloop_cli.scene.sequence import Sequence
from miniloop_cli.scene.timing import Timing
from miniloop_cli.stages.average import average
from miniloop_cli.stages.extract import extract
from miniloop_cli.stages.guided_matching import match_guided, replace_edges
from miniloop_cli.stages.match import comparer, listed_pairs, retrieved_pairs
from miniloop_cli.stages.refine import refined
from miniloop_cli.stages.serialization import edges_fingerprint, edges_kept, found_kept, matches_by_chunk, steps_kept
from miniloop_cli.stages.solve_edges import solve_edges
from miniloop_cli.typing import Pair
from miniloop_cli.verification.photometric_check import PhotometricCheck
from miniloop_cli.verification.pose_prior import pairs_by_pose_prior
from miniloop_cli.verification.priors import apply_priors
from miniloop_cli.verification.repetition import steps_m

NO_PRIORS = Priors()


@single_inner_threads()
def register(
    sequence: Sequence, settings: Settings, store: Store, workers: Workers, seed: int = 0, priors: Priors = NO_PRIORS
) -> Registration:
    """Poses of all scans of a sequence; `priors`: what is known of its frames beside their images.

    Raises RegistrationError, which carries the run so far, if no two scans could be registered.
    """
    watch = Stopwatch()
    count = len(sequence.frames)
    with watch.stage("features"):
        scans = list(extract(sequence, settings, store, workers))
        features = [scan.features for scan in scans]
        features_key = fingerprint([scan.key for scan in scans])
    with watch.stage("matching"):
        points = [scan_points(found, sequence.camera) for found in features]
        matches_key = fingerprint(features_key, settings.matching.model_dump())
        likely = None
        if priors.T_world_cam is not None:
            likely = pairs_by_pose_prior(priors.T_world_cam, points, sequence.camera, settings.pose_prior)
        matches = _match(features, points, settings, matches_key, store, workers, likely)
    with watch.stage("edges"):
        solving = [section.model_dump() for section in (settings.ransac, settings.verification, settings.cycles)]
        edges_key = fingerprint(matches_key, list(matches), solving, seed)
        edges = edges_kept(matches, edges_key, store, lambda: solve_edges(matches, points, settings, seed, workers))
        edges, vertical, notes = apply_priors(edges, priors, matches, points, settings, seed, workers)
    with watch.stage("averaging"):
        looking = [
            settings.ransac.model_dump(),
            settings.verification.chi2,
            settings.averaging.min_photo_consistency > 0,
        ]
        steps = steps_kept(
            fingerprint(features_key, looking),
            store,
            lambda: steps_m(features, points, sequence.camera.width, settings, workers),
        )
        outline = [found.outline for found in features]
        views = [scan.view for scan in scans]
        photometric = PhotometricCheck(views, points, outline, steps, sequence.camera, store, features_key)
        poses, edges = average(edges, count, settings.averaging, photometric)
        if settings.verification.guided_matching and len(poses.registered) > 1:
            again = [settings.matching.min_matches, settings.bundle.model_dump(), *solving]
            more = found_kept(
                fingerprint(features_key, edges_fingerprint(edges), again),
                store,
                lambda: match_guided(
                    edges, beginning(edges, count), features, points, sequence.camera, settings, workers
                ),
            )
            if more:
                poses, edges = average(replace_edges(edges, more), count, settings.averaging, photometric)
        if len(poses.registered) < 2:
            unknown = np.full((count, 6, 6), np.nan)
            run = Registration(sequence, settings, seed, scans, edges, poses, unknown, Timing(), watch.seconds, notes)
            raise RegistrationError(_why_nothing(scans, edges, settings), run)
    with watch.stage("refinement"):
        stamps = np.array([frame.timestamp_s for frame in sequence.frames])
        depth_stamps = np.array([frame.depth_timestamp_s or frame.timestamp_s for frame in sequence.frames])
        inputs = Scans(features, points, stamps, depth_stamps, sequence.camera, vertical)
        found = refined(poses, edges, inputs, features_key, settings, store, workers)
    return Registration(
        sequence, settings, seed, scans, edges, found.poses, found.covariance, found.timing, watch.seconds, notes
    )


def _match(
    features: list[ScanFeatures],
    points: list[ScanPoints],
    settings: Settings,
    key: str,
    store: Store,
    workers: Workers,
    likely: list[Pair] | None = None,
) -> Matches:
    """Matches of the pairs that the settings name; of a long recording first those retrieved, then around its loops.

    `likely`: the pairs that rough poses name, in place of all or of those retrieved.
    """
    matching = settings.matching
    compare = comparer(features, points, settings, workers)
    if matching.pairs == "auto" and likely is not None:
        return matches_by_chunk(likely, key, store, compare)
    if matching.pairs != "auto" or len(features) <= matching.exhaustive_max_scans:
        return matches_by_chunk(listed_pairs(len(features), matching.pairs, matching), key, store, compare)
    small = [compact(scan.descriptors[:DESCRIBED_FEATURES], settings.features.type)[0] for scan in features]
    pairs = retrieved_pairs(small, matching, np.random.default_rng(0))
    found = matches_by_chunk(pairs, key, store, compare)
    loops = [(i, j) for i, j in found if j - i > matching.sequential_window]
    more = sorted(around(loops, len(features)) - set(pairs))
    return found | matches_by_chunk(more, key, store, compare)


def _why_nothing(scans: list[ExtractedScan], edges: list[Edge], settings: Settings) -> str:
    """One line for a sequence in which no two scans could be registered."""
    unreadable = sum(bool(scan.problem) for scan in scans)
    if unreadable and unreadable > len(scans) - 2:
        first = next(scan.problem for scan in scans if scan.problem)
        return f"{unreadable} of {len(scans)} frames cannot be read (first: {first})"
    if len(scans) < 2:
        return "one frame only: there is nothing to register it to"
    with_depth = np.median([scan.features.with_depth for scan in scans])
    if with_depth < settings.matching.min_matches:
        return (
            f"no scan was registered: half of the frames have at most {with_depth:.0f} features with depth; "
            "look at the images (blur, exposure, texture) and at the depth range (depth.min_m, depth.max_m)"
        )
    best = max(edges, key=lambda edge: edge.inlier_count, default=None)
    if best is not None and best.inlier_count >= settings.verification.min_inliers:
        return f"no scan was registered: none of {len(edges)} overlaps was believed (the best one: {best.reason})"
    return (
        f"no scan was registered: {len(edges)} of {len(scans) * (len(scans) - 1) // 2} pairs have "
        f"{settings.matching.min_matches} or more matches and none was verified; do the scans overlap, and is the "
        "depth scale right (--camera)?"
    )
