"""The whole run: the stages in order, each from named inputs to named outputs, timed."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from miniloop_cli.averaging.optimum import prove_optimum
from miniloop_cli.config import Settings
from miniloop_cli.datasets.own_cameras import with_camera
from miniloop_cli.refinement.inputs import Between, Refined
from miniloop_cli.refinement.two_cameras import TwoCameras
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.parallel import Workers, single_inner_threads
from miniloop_cli.runtime.stopwatch import Stopwatch
from miniloop_cli.scene.certificate import Certificate
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.priors import Priors
from miniloop_cli.scene.registration import Registration, RegistrationError
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.sequence import Note, Sequence
from miniloop_cli.scene.tracked import Tracked
from miniloop_cli.stages.average import average, photometric_check
from miniloop_cli.stages.depth_beside_color import depth_beside_color
from miniloop_cli.stages.doubt import doubt
from miniloop_cli.stages.extract import extract
from miniloop_cli.stages.guided_matching import guided_matching
from miniloop_cli.stages.match import match
from miniloop_cli.stages.refine import refine
from miniloop_cli.stages.run import Run
from miniloop_cli.stages.solve_edges import solve_edges
from miniloop_cli.stages.track import track
from miniloop_cli.stages.two_cameras import asks_for_two_cameras, calibrate_two_cameras, with_cameras
from miniloop_cli.tracking.all_frames import (
    in_frames,
    keyframes_only,
    of_all_frames,
    priors_among,
    priors_of,
    with_followed,
)
from miniloop_cli.tracking.order import notes_on_order
from miniloop_cli.tracking.repeated import notes_on_repeats
from miniloop_cli.verification.priors import apply_priors

LOG = logging.getLogger("miniloop")
NO_PRIORS = Priors()


@single_inner_threads()
def register(
    sequence: Sequence, settings: Settings, store: Store, workers: Workers, seed: int = 0, priors: Priors = NO_PRIORS
) -> Registration:
    """Poses of all scans of a sequence; `priors`: of its frames.

    Raises RegistrationError, which carries the run so far, if no two scans could be registered.
    """
    watch = Stopwatch()
    if not asks_for_two_cameras(sequence, settings):
        return _register(sequence, settings, store, workers, seed, priors, watch)
    with watch.stage("two cameras"):

        def alone(some: Sequence, asking: Settings, two: TwoCameras) -> Registration:
            return _register(some, asking, store, workers, seed, NO_PRIORS, Stopwatch(), two)

        found = calibrate_two_cameras(sequence, settings, workers, alone)
    if found is None or not found.changed:
        run = _register(sequence, settings, store, workers, seed, priors, watch)
        return replace(run, calibration=run.calibration or found)
    sequence = with_cameras(sequence, found.camera, found.depth_camera)
    # Both were calibrated already; camera.yaml must not mix the values of two calibrations.
    known = settings.model_copy(update={"calibrate": "off"})
    run = _register(sequence, known, store, workers, seed, priors, watch)
    return replace(run, settings=settings, calibration=replace(found, beforehand=True))


def _register(
    sequence: Sequence,
    settings: Settings,
    store: Store,
    workers: Workers,
    seed: int,
    priors: Priors,
    watch: Stopwatch,
    two: TwoCameras | None = None,
) -> Registration:
    """The stages; `two`: for a separate depth camera that is calibrated."""
    run, estimation = Run(store, workers, seed), settings.estimation
    recording = whole = sequence
    of_whole, features = priors, settings.features
    with watch.stage("tracking"):
        tracked = follow(sequence, settings, run)
    if sequence.color_only:  # whether these images are used is known only now
        tell(sequence.color_only.taken_in if tracked else [sequence.color_only.left_out])
    if tracked:
        whole, rows = sequence.with_color_only()
        along = [*notes_on_repeats(tracked), *notes_on_order(tracked)]
        tell(along)
        whole = replace(whole, notes=(*whole.notes, *along))
        priors = of_whole = priors_among(priors, rows, len(whole.frames))
        sequence, priors = keyframes_only(whole, tracked.keyframes), priors_of(priors, tracked.keyframes)
        features = features.of_keyframes(sequence.camera.width, sequence.camera.height)
    with watch.stage("features"):
        scans = extract(sequence, features, settings.depth, run)
        seen = () if two else depth_beside_color(recording, run)
        tell(seen)
        whole = replace(whole, notes=(*whole.notes, *seen))
    with watch.stage("matching"):
        matches = match(scans, settings.matching, settings.pose_prior, priors, run)
    with watch.stage("edges"):
        edges = solve_edges(matches, scans, estimation, run)
        edges, vertical, said = apply_priors(edges, priors, matches, scans.points, settings, seed, workers)
        solved, notes = edges, (*whole.notes, *priors.notes, *said)
    with watch.stage("averaging"):
        looks = settings.averaging.min_photo_consistency > 0
        photometric = photometric_check(scans, estimation.ransac, estimation.verification.chi2, run) if looks else None
        poses, edges = average(edges, scans, settings.averaging, photometric, run)
        if estimation.verification.guided_matching and len(poses.registered) > 1:
            min_matches = settings.matching.min_matches
            more = guided_matching(poses, edges, scans, estimation, settings.bundle, min_matches, run)
            if more is not edges:
                poses, edges = average(more, scans, settings.averaging, photometric, run)
        if tracked and (more := with_followed(edges, tracked)) is not edges:
            poses, edges = average(more, scans, settings.averaging, photometric, run)
        poses, certificate = prove_optimum(poses, edges, settings.averaging)
    between = Between.of(tracked, whole, vertical, of_whole.accelerometer) if tracked else None
    found = partial(_registration, scans, edges, settings, seed, watch, notes, whole, tracked, vertical is not None)
    if len(poses.registered) < 2:
        poses = tracked.all_poses(poses) if tracked else poses
        unknown = Refined(poses, np.full((len(poses.component), 6, 6), np.nan))
        raise RegistrationError(_why_nothing(scans, edges, settings), found(unknown))
    with watch.stage("refinement"):
        refined = refine(
            poses,
            edges,
            scans,
            settings.refine,
            settings.bundle,
            vertical,
            run,
            between,
            settings.calibrate,
            two,
        )
    of_scans = refined.poses.of(tracked.keyframes) if tracked else refined.poses
    if settings.refine != "none":
        certificate = certificate.refined(of_scans)
    LOG.info("%s", certificate.sentence)
    doubts = doubt(of_scans, solved, edges, scans, whole, tracked, settings, photometric, run)
    return found(refined, certificate, doubts)


def follow(sequence: Sequence, settings: Settings, run: Run) -> Tracked | None:
    """Tracking through a whole recording; None for scans without order, and if pairs are listed."""
    if settings.matching.pairs not in ("auto", "exhaustive"):
        return None
    return track(sequence, settings.depth, settings.tracking, run)


def tell(notes: Iterable[Note]) -> None:
    """Log the notes, those that make a result doubtful as warnings."""
    for note in notes:
        LOG.log(logging.WARNING if note.doubtful else logging.INFO, "%s", note)


def _registration(
    scans: ScanSet,
    edges: EdgeTable,
    settings: Settings,
    seed: int,
    watch: Stopwatch,
    notes: tuple[Note, ...],
    whole: Sequence,
    tracked: Tracked | None,
    leveled: bool,
    refined: Refined,
    certificate: Certificate | None = None,
    doubts: tuple[Note, ...] = (),
) -> Registration:
    """The run, by frames of the whole recording."""
    calibration = refined.calibration
    return Registration(
        with_camera(whole, calibration.camera) if calibration and calibration.changed else whole,
        settings,
        seed,
        of_all_frames(scans.extracted, tracked) if tracked else list(scans.extracted),
        in_frames(edges, tracked.keyframes) if tracked else edges,
        refined.poses,
        refined.covariance,
        refined.timing,
        watch.seconds,
        watch.cpu_seconds,
        (*notes, *((certificate.note,) if certificate else ()), *doubts),
        tracked.status if tracked else None,
        certificate,
        leveled,
        refined.landmarks,
        refined.velocity,
        calibration,
        tracked.thumbnails if tracked else {},
    )


def _why_nothing(scans: ScanSet, edges: EdgeTable, settings: Settings) -> str:
    """One line for a sequence in which no two scans could be registered."""
    problems = [scan.problem for scan in scans.extracted if scan.problem]
    if problems and len(problems) > len(scans) - 2:
        return f"{len(problems)} of {len(scans)} frames cannot be read (first: {problems[0]})"
    if len(scans) < 2:
        return "the recording has only one frame; at least two are needed"
    with_depth = np.median([features.with_depth for features in scans.features])
    if with_depth < settings.matching.min_matches:
        return (
            f"no scan was registered: half of the frames have at most {with_depth:.0f} features with depth; "
            "look at the images (blur, exposure, texture) and at the depth range (depth.min_m, depth.max_m)"
        )
    inliers = edges.inlier_count
    if len(edges) and inliers.max() >= settings.verification.min_inliers:
        best = edges.reasons()[int(inliers.argmax())]
        return f"no scan was registered: none of {len(edges)} overlapping pairs was accepted (the best one: {best})"
    return (
        f"no scan was registered: {len(edges)} of {len(scans) * (len(scans) - 1) // 2} pairs have "
        f"{settings.matching.min_matches} or more matches and none was verified; do the scans overlap, and is the "
        "depth scale right (--camera)?"
    )
