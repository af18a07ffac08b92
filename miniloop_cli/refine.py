"""The joint refinement of all poses: by bundle adjustment over feature tracks, or over the edges of the graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from miniloop_cli.config import Settings
from miniloop_cli.features.detect import compact
from miniloop_cli.features.guided import guided_match
from miniloop_cli.features.lift import ScanFeatures
from miniloop_cli.geometry import se3
from miniloop_cli.graph.edges import Edge
from miniloop_cli.graph.overlap import Pair, ScanPoints
from miniloop_cli.graph.visibility import partners
from miniloop_cli.parallel import Workers
from miniloop_cli.poses import Poses, used
from miniloop_cli.refinement.bundle import BundleResult, BundleSettings, bundle_adjust
from miniloop_cli.refinement.posegraph import refine_pose_graph
from miniloop_cli.refinement.timing import (
    Flow,
    Measurements,
    Timing,
    camera_depths,
    corrected,
    flow,
    slopes,
    twists,
)
from miniloop_cli.refinement.tracks import build_tracks
from miniloop_cli.scans.camera import Camera

Floats = NDArray[np.float64]
CALIBRATION_OBSERVATIONS = 60_000  # are plenty for two numbers
LEAST_GAIN = 0.002  # share of the cost that timing must take away to be believed
MIN_SHARED = 10  # tracks that tie two scans to each other
MOST_S = 0.1  # no sensor is that late
MOST_STEPS, LONGEST_STEP_S, SETTLED_S = 5, 0.02, 0.0015
FOLLOWING = 0.15  # of the cost's curvature by a time is left where poses and points follow it, as measured
COMMON_ERROR = 1.6  # in sigmas: what views have in common, as a patch seen from the side, shows in no residual
NO_TIMING = Timing()


@dataclass(frozen=True)
class Scans:
    """What refinement needs of the scans: features, points, stamps of colour and of depth (n,) seconds, the camera."""

    features: Sequence[ScanFeatures]
    points: Sequence[ScanPoints]
    stamps_s: Floats
    depth_stamps_s: Floats
    camera: Camera


@dataclass(frozen=True)
class Refined:
    """Poses, their covariances (n, 6, 6; NaN where there are none) and the timing that was found.

    Those of a bundle adjustment are widened by COMMON_ERROR, measured on simulated recordings (docs/trust.md).
    """

    poses: Poses
    covariance: Floats
    timing: Timing = NO_TIMING


def refine(poses: Poses, edges: Sequence[Edge], scans: Scans, settings: Settings, workers: Workers) -> Refined:
    """Refined poses of the largest component by the method of the settings."""
    nothing = np.full((len(scans.features), 6, 6), np.nan)
    inside = [e for e in used(edges, len(nothing)) if poses.component[e.i] == 0 == poses.component[e.j]]
    if settings.refine == "none" or not inside:
        return Refined(poses, nothing)
    bundled = _bundle(poses, inside, scans, settings, workers) if settings.refine == "bundle" else None
    return bundled or _over_edges(poses, inside)


def _over_edges(poses: Poses, inside: Sequence[Edge]) -> Refined:
    """Pose graph of the edges."""
    result = refine_pose_graph(
        poses.T_world_cam,
        [(e.i, e.j) for e in inside],
        np.array([e.T_j_i for e in inside]),
        np.array([e.information for e in inside]),
    )
    return Refined(Poses(result.T_world_cam, poses.component), result.covariance)


def _bundle(poses: Poses, inside: Sequence[Edge], scans: Scans, settings: Settings, workers: Workers) -> Refined | None:
    """Bundle adjustment of the edges' tracks, then of guided tracks, then with the timing undone.

    Where scans lie so far apart that hardly a point is seen three times, tracks of two scans must do; None if these,
    too, do not tie all scans to each other.
    """
    jobs = workers.threads
    first = _measure([(e.i, e.j) for e in inside], [e.matches[e.inliers] for e in inside], scans, 2)
    rough = BundleSettings(
        depth_sigma_factor=settings.bundle.depth_sigma_factor, relative_tolerance=1e-3, covariance=False
    )
    T = _adjust(poses.T_world_cam, first, scans.camera, rough, jobs).T_world_cam

    pairs = partners(T, poses.registered, scans.points, scans.camera, settings.bundle.partners)
    matches = guided_matches(T, pairs, scans, settings, workers)
    tracked = _measure(pairs, matches, scans, settings.bundle.min_frames)
    known = poses.component == 0
    if not tied(tracked, known):
        more = sorted({(e.i, e.j) for e in inside} - set(pairs))
        tracked = _measure(pairs + more, matches + guided_matches(T, more, scans, settings, workers), scans, 2)
        if not tied(tracked, known):
            return None
    fine = BundleSettings(depth_sigma_factor=settings.bundle.depth_sigma_factor, relative_tolerance=1e-4)
    timing = NO_TIMING
    if settings.bundle.timing:
        timing, T = calibrate(T, tracked, scans, known, rough, jobs)
    result = _adjust(T, tracked, scans.camera, fine, jobs, *_undone(T, None, tracked, scans, known, timing))
    covariance = result.covariance if result.covariance is not None else np.full((len(known), 6, 6), np.nan)
    return Refined(Poses(result.T_world_cam, poses.component), COMMON_ERROR**2 * covariance, timing)


def tied(measured: Measurements, known: NDArray[np.bool_]) -> bool:
    """Whether chains of scans that share MIN_SHARED tracks join all of the `known` scans (n,)."""
    ones = np.ones(len(measured.track))
    seen = coo_array(
        (ones, (measured.track, measured.frame)), shape=(int(measured.track.max(initial=-1)) + 1, len(known))
    )
    shared = (seen.T @ seen) >= MIN_SHARED
    return len(np.unique(connected_components(shared, directed=False)[1][known])) == 1


def guided_matches(
    T_world_cam: Floats, pairs: Sequence[Pair], scans: Scans, settings: Settings, workers: Workers
) -> list[NDArray[np.int64]]:
    """Matches of each pair where its poses say they must be; features without depth take part."""
    small = [compact(found.descriptors, settings.features.type) for found in scans.features]
    bundle = settings.bundle

    def one(pair: Pair) -> NDArray[np.int64]:
        i, j = pair
        T_j_i = se3.inverse(T_world_cam[j]) @ T_world_cam[i]
        return guided_match(
            scans.features[i], scans.features[j], small[i][0], small[j][0], T_j_i, scans.camera,
            bundle.radius_px, bundle.max_distance2 * small[i][1],
        )  # fmt: skip

    return list(workers.map(one, pairs, "matching, guided", len(pairs)))


def _measure(
    pairs: Sequence[Pair], matches: Sequence[NDArray[np.int64]], scans: Scans, min_frames: int
) -> Measurements:
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


def _adjust(
    T: Floats, measured: Measurements, camera: Camera, settings: BundleSettings, jobs: int,
    px: Floats | None = None, z_m: Floats | None = None,
) -> BundleResult:  # fmt: skip
    px, z_m = measured.px_ideal if px is None else px, measured.z_m if z_m is None else z_m
    return bundle_adjust(T, measured.frame, measured.track, px, z_m, camera, settings, jobs=jobs)


def _moving(T: Floats, points: Floats | None, measured: Measurements, scans: Scans, known: NDArray[np.bool_]) -> Flow:
    v, w = twists(T, scans.stamps_s, known)
    unknown = np.full((int(measured.track.max(initial=-1)) + 1, 3), np.nan)
    depth = camera_depths(measured, T, unknown if points is None else points)
    return flow(measured, depth, v, w, scans.camera)


def _undone(
    T: Floats, points: Floats | None, measured: Measurements, scans: Scans, known: NDArray[np.bool_], timing: Timing
) -> tuple[Floats, Floats]:
    if timing == NO_TIMING:
        return measured.px_ideal, measured.z_m
    return corrected(measured, _moving(T, points, measured, scans, known), timing)


def calibrate(
    T: Floats, tracked: Measurements, scans: Scans, known: NDArray[np.bool_], rough: BundleSettings, jobs: int
) -> tuple[Timing, Floats]:
    """Readout time and lag of depth under which the measurements agree best, and poses adjusted with them.

    Newton's method on the two times, each step after a bundle adjustment of part of the tracks: the slope of the
    cost is exact there, its curvature is the secant's. No timing at all is the answer where it takes away less than
    LEAST_GAIN of the cost, or where the times leave what a sensor can do.
    """
    count = int(tracked.track.max(initial=-1)) + 1
    every = int(np.ceil(len(tracked.track) / CALIBRATION_OBSERVATIONS))
    part = tracked.subset(tracked.track % max(every, 1) == 0) if count else tracked
    if not len(part.track):
        return NO_TIMING, T
    # With the stamps taken at their word but for the two unknown times; (0, 0) is the recording as its stamps say.
    plain = _adjust(T, part, scans.camera, rough, jobs)
    times, before = np.zeros(2), None
    result, cost = plain, plain.descent.cost_after
    for _ in range(MOST_STEPS):
        px, z_m = _undone_at(times, result, part, scans, known)
        result = _adjust(result.T_world_cam, part, scans.camera, rough, jobs, px, z_m)
        cost = result.descent.cost_after
        moving = _moving(result.T_world_cam, result.points_world, part, scans, known)
        sigma_z = rough.depth_sigma_factor * scans.camera.noise.sigma_m(np.nan_to_num(part.z_m, nan=1.0))
        gradient, curvature = slopes(
            part, moving, result.residual_px, result.residual_depth, result.weight_px, result.weight_depth,
            rough.sigma_px, sigma_z,
        )  # fmt: skip
        curvature *= FOLLOWING
        if before is not None:
            secant = (gradient - before[1]) / np.where(times == before[0], np.inf, times - before[0])
            curvature = np.where(secant > 0.3 * curvature, secant, curvature)
        before = (times, gradient)
        step = np.clip(-gradient / np.maximum(curvature, 1e-12), -LONGEST_STEP_S, LONGEST_STEP_S)
        times = times + step
        if np.abs(step).max() < SETTLED_S:
            break
    least = (1 - LEAST_GAIN) * plain.descent.cost_after  # nothing to gain where nothing takes part
    if not cost < least or not (np.abs(times) < MOST_S).all():
        return NO_TIMING, plain.T_world_cam
    return Timing(float(times[0]), float(times[1])), result.T_world_cam


def _undone_at(
    times: Floats, result: BundleResult, part: Measurements, scans: Scans, known: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    return corrected(part, _moving(result.T_world_cam, result.points_world, part, scans, known), Timing(*times))
