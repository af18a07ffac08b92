"""The joint refinement of all poses: by bundle adjustment over feature tracks, or over the edges of the graph."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array

from miniloop_cli.config import Bundle, Refinement
from miniloop_cli.features.guided import guided_matches
from miniloop_cli.geometry import se3
from miniloop_cli.graph.visibility import best_partners
from miniloop_cli.refinement.bundle import BundleResult, BundleSettings
from miniloop_cli.refinement.followed import followed_measurements, joined, motions, surface_motions, weakly_measured
from miniloop_cli.refinement.gravity import upright
from miniloop_cli.refinement.inputs import Between, Refined, Scans
from miniloop_cli.refinement.motion_term import MotionTerm
from miniloop_cli.refinement.posegraph import PoseGraphResult, refine_pose_graph
from miniloop_cli.refinement.rolling_shutter import NO_TIMING, MovingCamera, adjust, adjust_moving, calibrate
from miniloop_cli.refinement.self_calibration import recalibrated, self_calibrate
from miniloop_cli.refinement.terms import PoseTerm
from miniloop_cli.refinement.timing import Measurements
from miniloop_cli.refinement.tracks import build_tracks
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.landmarks import Landmarks
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.timing import Timing
from miniloop_cli.scene.view_graph import components
from miniloop_cli.typing import Bools, Floats, Ints, Pair

LOG = logging.getLogger("miniloop")
LEAST_WEIGHT = 0.1  # of an observation of a landmark: three scales of the kernel, or 2.2 px in the last step
MIN_SHARED = 10  # shared tracks that join two scans
# Kernels that are wide enough to find the poses let false matches shrink the motion by some tenths of a per cent. In
# the last step, pixels off by more than 0.75 and depths off by more than their sigma count less (docs/refinement.md).
SHARP = BundleSettings(sigma_px=0.25, scale_px=3.0, scale_depth=1.0, relative_tolerance=1e-3)


def refine_jointly(
    poses: Poses,
    inside: EdgeTable,
    scans: Scans,
    method: Refinement,
    settings: Bundle,
    workers: Workers,
    between: Between | None = None,
    calibrated: bool = False,
) -> Refined:
    """Refined poses of the largest component, by the method, from the edges used inside of it.

    `between`: of a whole recording, whose keyframes the scans are; then the poses are those of all frames.
    `calibrated`: the bundle adjustment also estimates the camera.
    """
    if method == "bundle":
        if len(poses.registered) <= settings.max_scans:
            bundled = _bundle(poses, inside, scans, settings, workers, between, calibrated)
            if bundled:
                return bundled
        else:
            LOG.warning(
                "more than %d scans (bundle.max_scans): the pose graph is refined, without bundle adjustment",
                settings.max_scans,
            )
    refined = _over_edges(poses, inside, scans)
    if between is None:
        return refined
    of_all = between.tracked.all_poses(refined.poses)
    covariance = np.full((len(of_all.component), 6, 6), np.nan)
    covariance[between.tracked.keyframes] = refined.covariance
    return Refined(of_all, covariance, refined.timing)


def level(poses: Poses, scans: Scans) -> tuple[Poses, list[PoseTerm]]:
    """The poses, turned so that z is up, and the term that keeps them so; unchanged without an accelerometer."""
    found = None
    if scans.accelerometer is not None:
        found = upright(scans.accelerometer, poses.T_world_cam, scans.stamps_s, poses.component == 0)
    if found is None:
        return poses, []
    return Poses(found.T_up_world @ poses.T_world_cam, poses.component), [found.term]


def _over_edges(poses: Poses, inside: EdgeTable, scans: Scans) -> Refined:
    """Pose graph of the edges."""
    poses, pose_terms = level(poses, scans)
    result = refine_pose_graph(
        poses.T_world_cam,
        inside.pairs,
        inside.T_j_i,
        inside.information,
        pose_terms=pose_terms,
    )
    return _refined(result, poses)


def _refined(result: PoseGraphResult | BundleResult, poses: Poses, timing: Timing = NO_TIMING) -> Refined:
    unknown = np.full((len(poses.component), 6, 6), np.nan)
    covariance = unknown if result.covariance is None else result.covariance
    # The last bits depend on how this process compiled the kernels. Rounding gives the same bytes everywhere: poses to
    # a nanometre, covariances to six digits, of which one or two are significant.
    T_world_cam = np.round(result.T_world_cam, 9) + 0.0  # and zero has one sign
    return Refined(Poses(T_world_cam, poses.component), six_digits(covariance), timing)


def six_digits(values: Floats) -> Floats:
    """The values (...) with six significant digits; zero, infinity and NaN stay as they are."""
    kept = np.isfinite(values) & (values != 0)
    unit = 10.0 ** (np.floor(np.log10(np.abs(values, where=kept, out=np.ones_like(values)))) - 5)
    return np.where(kept, np.round(values / unit) * unit, values)


def _bundle(
    poses: Poses,
    inside: EdgeTable,
    scans: Scans,
    settings: Bundle,
    workers: Workers,
    between: Between | None,
    calibrated: bool,
) -> Refined | None:
    """Bundle adjustment of the edges' tracks, then of guided tracks, then with timing and camera errors corrected.

    If scans are so far apart that few points are seen three times, tracks of two scans are used; None if these do not
    join all scans either. The frames between keyframes take part with the points tracked in them.
    """
    jobs = workers.threads
    used = [(int(i), int(j)) for i, j in inside.pairs]
    first = _measure(used, [inside.inlier_rows(edge) for edge in range(len(inside))], scans, 2)
    rough = BundleSettings(depth_sigma_factor=settings.depth_sigma_factor, relative_tolerance=1e-3, covariance=False)
    T = adjust(poses.T_world_cam, first, scans.camera, rough, jobs).T_world_cam

    pairs = best_partners(T, poses.registered, scans.points, scans.camera, settings.partners, inside)
    matches = _guided(T, pairs, scans, settings, workers)
    stamps_s, accelerometer, keyframes = scans.stamps_s, scans.accelerometer, np.arange(len(T))
    if between:
        keyframes = between.tracked.keyframes
        poses = between.tracked.all_poses(Poses(T, poses.component))
        T, stamps_s, accelerometer = poses.T_world_cam, between.stamps_s, between.accelerometer
    known = poses.component == 0

    def measured(pairs: Sequence[Pair], matches: Sequence[Ints], min_frames: int) -> Measurements:
        of_scans = _measure(pairs, matches, scans, min_frames)
        if between is None:
            return of_scans
        followed = followed_measurements(between, known, scans.camera, settings.followed_per_frame)
        return joined(of_scans, keyframes, followed)

    tracked = measured(pairs, matches, settings.min_frames)
    terms: list[MotionTerm] = []
    if between:
        weak = weakly_measured(between, known, tracked)
        loose = untied(tracked.track, tracked.frame, known, surface_motions(between, known, weak))
        terms = surface_motions(between, known, np.setdiff1d(weak, loose)) + motions(between, known, loose)
    if len(untied(tracked.track, tracked.frame, known, terms)):
        more = sorted(set(used) - set(pairs))
        tracked = measured(pairs + more, matches + _guided(T[keyframes], more, scans, settings, workers), 2)
    if len(loose := untied(tracked.track, tracked.frame, known, terms)):
        # Few points join these to the others, so the edges that averaging used take part.
        ends = keyframes[inside.pairs]
        across = np.isin(ends, loose).any(axis=1)
        edges = inside.subset(across)
        terms.append(MotionTerm.of(ends[across], edges.T_j_i, edges.information))
        if len(untied(tracked.track, tracked.frame, known, terms)):
            return None
    fine = replace(SHARP, depth_sigma_factor=settings.depth_sigma_factor)
    moving, timing = MovingCamera(scans.camera, stamps_s, known, accelerometer, tuple(terms)), NO_TIMING
    if settings.timing:
        timing, T = calibrate(T, tracked, moving, rough, jobs)
    calibration = self_calibrate(T, tracked, moving, timing, rough, fine, jobs, scans.two) if calibrated else None
    if calibration and calibration.changed:
        tracked, moving = recalibrated(tracked, calibration), replace(moving, camera=calibration.camera)
    # A path as dense as this determines the motion within a frame better than the frame's own rows.
    feel = settings.motion and between is None
    result, timing, motion = adjust_moving(T, tracked, moving, timing, rough, fine, jobs, feel)
    velocity = None if motion is None else np.concatenate(motion[::-1], axis=1)
    found = _refined(result, poses, timing)
    return replace(found, landmarks=landmarks_of(result, tracked), velocity=velocity, calibration=calibration)


def landmarks_of(result: BundleResult, measured: Measurements) -> Landmarks:
    """The points of an adjustment and the measurements that agree with them, as they were measured in the images."""
    good = (
        result.used & (result.weight_px > LEAST_WEIGHT) & np.isfinite(result.points_world[measured.track]).all(axis=1)
    )
    rows = np.lexsort((measured.frame, measured.track))
    found = Landmarks(
        np.round(result.points_world, 9),
        measured.track[rows].astype(np.int32),
        measured.frame[rows].astype(np.int32),
        measured.px_ideal[rows].astype(np.float32),
    )
    return found.seen_at(good[rows])


def untied(track: Ints, frame: Ints, known: Bools, terms: Sequence[MotionTerm] = ()) -> Ints:
    """The `known` scans (n,) that no chain of shared tracks or motions joins to most of the others.

    track, frame (k,): which scan sees which. A link of the chain is MIN_SHARED tracks that two scans share, or a motion
    that is known in all directions.
    """
    seen = coo_array((np.ones(len(track)), (track, frame)), shape=(int(track.max(initial=-1)) + 1, len(known)))
    shared = ((seen.T @ seen) >= MIN_SHARED).tocoo()
    different = shared.row < shared.col
    by_motions = [term.frames[term.full] for term in terms]
    pairs = np.concatenate([np.stack([shared.row, shared.col], axis=1)[different], *by_motions])
    group = components(len(known), pairs)
    most = np.bincount(group[known]).argmax() if known.any() else 0
    return np.flatnonzero(known & (group != most))


def _guided(T_world_cam: Floats, pairs: Sequence[Pair], scans: Scans, settings: Bundle, workers: Workers) -> list[Ints]:
    """Matches of each pair near the positions that its poses predict; features without depth take part."""
    i, j = np.array(pairs, np.int64).reshape(-1, 2).T
    T_j_i = se3.inverse(T_world_cam[j]) @ T_world_cam[i]
    return guided_matches(pairs, T_j_i, scans.features, scans.feature_type, scans.camera, settings, workers)


def _measure(pairs: Sequence[Pair], matches: Sequence[Ints], scans: Scans, min_frames: int) -> Measurements:
    """Tracks through the matches, as measurements."""
    features = scans.features
    offsets = np.cumsum([0] + [len(found) for found in features])
    tracks = build_tracks(offsets, pairs, matches, None, min_frames)
    rows = offsets[tracks.frame] + tracks.feature

    def column(name: str) -> Floats:
        return np.concatenate([getattr(found, name) for found in features])[rows]

    row_share = (column("px")[:, 1] - (scans.camera.height - 1) / 2) / scans.camera.height
    lag = (scans.depth_stamps_s - scans.stamps_s)[tracks.frame]
    return Measurements(tracks.frame, tracks.track, row_share, column("px_ideal"), column("z_m"), column("slope"), lag)
