"""Adjustment of new keyframes to a map: first with the keyframes that share their points, then of all that still moves.

With robust kernels, points converge slowly: with steps of poses and points together, the last millimetre takes dozens
of steps. A step of the points alone costs a third and does most of the work, so points go first. Weakly determined
keyframes converge last: all are adjusted once, then only those that still move, while the others are fixed.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from miniloop_cli.config import Bundle
from miniloop_cli.geometry import se3
from miniloop_cli.refinement.bundle import BundleResult, BundleSettings, bundle_adjust
from miniloop_cli.refinement.joint import MIN_SHARED, SHARP, six_digits, untied
from miniloop_cli.refinement.motion_term import MotionTerm
from miniloop_cli.refinement.terms import PoseTerm
from miniloop_cli.refinement.tracks import Tracks
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.scene_map import MapPoints
from miniloop_cli.typing import Bools, Floats, Ints

LOG = logging.getLogger("miniloop")
ROUNDS, POINT_STEPS, WHOLE_STEPS, TOLERANCE = 8, 6, 3, 1e-6


class Rest(NamedTuple):
    """A keyframe rests if a round of adjustment moves it by no more than this."""

    distance_m: float
    angle_deg: float


AT_REST, NEARLY_AT_REST = Rest(0.0001, 0.004), Rest(0.002, 0.1)


@dataclass(frozen=True)
class Observations:
    """Observations of the tracks of a piece in its keyframes, row by row."""

    frame: Ints
    track: Ints
    px_ideal: Floats
    z_m: Floats

    @staticmethod
    def of(tracks: Tracks, scans: ScanSet, min_frames: int) -> Observations:
        """The observations of tracks with at least `min_frames` keyframes."""
        long = np.bincount(tracks.track, minlength=tracks.count) >= min_frames
        kept = long[tracks.track]
        row = scans.first_feature[tracks.frame[kept]] + tracks.feature[kept]
        px = np.concatenate([features.px_ideal for features in scans.features])[row]
        z_m = np.concatenate([features.z_m for features in scans.features])[row]
        return Observations(tracks.frame[kept], tracks.track[kept], px, z_m)

    def subset(self, rows: Bools) -> Observations:
        """The observations of a mask rows (n,)."""
        return Observations(self.frame[rows], self.track[rows], self.px_ideal[rows], self.z_m[rows])

    def of_tracks_seen_by(self, keyframes: Bools) -> Observations:
        """The observations of tracks seen by some of these keyframes (K,)."""
        touched = np.zeros(int(self.track.max(initial=-1)) + 1, bool)
        touched[self.track[keyframes[self.frame]]] = True
        return self.subset(touched[self.track])

    def adjusted(
        self,
        T: Floats,
        scans: ScanSet,
        settings: BundleSettings,
        jobs: int,
        held: Bools,
        points: Floats | None,
        terms: Sequence[PoseTerm] = (),
    ) -> BundleResult:
        """The poses, from T (n, 4, 4), and points (p, 3) that fit best; held (n,) marks fixed poses."""
        measured = self.frame, self.track, self.px_ideal, self.z_m
        return bundle_adjust(T, *measured, scans.camera, settings, jobs, points, terms, held=held)


def most_certain(covariance: Floats, among: Bools) -> int:
    """The keyframe `among` some (K,) whose covariance (K, 6, 6) has the smallest trace."""
    return int(np.where(among, np.einsum("kii->k", covariance), np.inf).argmin())


def shared_tracks(seen: Observations, new: Bools) -> Ints:
    """(K,) number of tracks of each keyframe that the `new` ones (K,) also see."""
    counts: Ints = np.bincount(seen.of_tracks_seen_by(new).frame, minlength=len(new))
    return counts


def adjusted_locally(
    T_world_cam: Floats, seen: Observations, new: Bools, scans: ScanSet, settings: Bundle, jobs: int
) -> Floats:
    """(K, 4, 4) poses with the `new` keyframes (K,), and those that share points with them, adjusted; others fixed."""
    active: Bools = new | (shared_tracks(seen, new) >= MIN_SHARED)
    rough = BundleSettings(depth_sigma_factor=settings.depth_sigma_factor, relative_tolerance=1e-3, covariance=False)
    return seen.of_tracks_seen_by(active).adjusted(T_world_cam, scans, rough, jobs, ~active, None).T_world_cam


def adjusted_until_rest(
    T_world_cam: Floats,
    points: Floats,
    seen: Observations,
    terms: Sequence[PoseTerm],
    fixed: int,
    scans: ScanSet,
    settings: Bundle,
    jobs: int,
    active: Bools,
    rest: Rest,
) -> tuple[Floats, Floats]:
    """Poses (K, 4, 4) and points (tracks, 3) at rest, from nearly correct poses; keyframe `fixed` keeps its pose.

    points: NaN where unknown. active (K,): the keyframes that are adjusted; the others keep their poses.
    """
    T, points, fine = T_world_cam, points.copy(), _fine(settings)
    everybody = np.ones(len(T), bool)

    def adjust(part: Observations, steps: int, held: Bools) -> Floats:
        kind = replace(fine, max_iterations=steps, fixed_frame=fixed)
        found = part.adjusted(T, scans, kind, jobs, held, points, terms)
        known = np.flatnonzero(np.isfinite(found.points_world).all(axis=1))
        points[known] = found.points_world[known]
        return found.T_world_cam

    held = ~active
    for _ in range(ROUNDS):
        part = seen.of_tracks_seen_by(active)
        if np.isnan(points[part.track]).any():
            adjust(part, POINT_STEPS, everybody)  # points begun roughly would bend the poses
        T_before, T = T, adjust(part, WHOLE_STEPS, held)
        angle_deg, distance_m = se3.angle_and_distance(se3.inverse(T_before) @ T)
        LOG.debug("%d keyframes adjusted, moved by up to %.3f cm", active.sum(), 100 * distance_m.max())
        active = (distance_m > rest.distance_m) | (angle_deg > rest.angle_deg)
        held = ~active
        if not active.any():
            break
    # The last bits depend on how this process compiled the kernels; rounding to a nanometre gives the same bytes.
    return np.round(T, 9) + 0.0, points


class Settled(NamedTuple):
    """Poses (K, 4, 4) and points (tracks, 3) at rest, the observations, and the terms of edges."""

    T_world_cam: Floats
    points: Floats
    seen: Observations
    terms: Sequence[PoseTerm]


def settled(
    T_world_cam: Floats,
    points: Floats,
    tracks: Tracks,
    edges: EdgeTable,
    inside: Bools,
    fixed: int,
    scans: ScanSet,
    settings: Bundle,
    jobs: int,
    active: Bools | None = None,
    rest: Rest = AT_REST,
) -> Settled:
    """Keyframes `inside` a piece (K,), adjusted until they rest. Edges hold those that few points tie to the others.

    Keyframes that neither ties, `fixed`, and those that are not `active` (K,), keep their poses; None: all are active.
    T_world_cam (K, 4, 4), points (tracks, 3): where they start; points are NaN where unknown.
    """
    seen = Observations.of(tracks, scans, settings.min_frames)
    seen = seen.subset(inside[seen.frame])
    terms: list[MotionTerm] = []
    apart = untied(seen.track, seen.frame, inside)
    across = edges.subset(np.isin(edges.pairs, apart).any(axis=1))
    if len(across):
        terms = [MotionTerm.of(across.pairs, across.T_j_i, across.information)]
        apart = untied(seen.track, seen.frame, inside, terms)
    seen = seen.subset(~np.isin(seen.frame, apart))
    active = inside if active is None else active & inside
    found = adjusted_until_rest(T_world_cam, points, seen, terms, fixed, scans, settings, jobs, active, rest)
    return Settled(*found, seen, terms)


def covariance_beside_the_map(found: Settled, new: Bools, scans: ScanSet, settings: Bundle, jobs: int) -> Floats:
    """(k, 6, 6) covariances of the `new` keyframes (K,) where they were `found`, given all others.

    Covariances are of (w, v) in the camera's frame.
    """
    kind = replace(_fine(settings), covariance=True, max_iterations=0)
    part = found.seen.of_tracks_seen_by(new)
    result = part.adjusted(found.T_world_cam, scans, kind, jobs, ~new, found.points, found.terms)
    assert result.covariance is not None
    return six_digits(result.covariance[new])


def _fine(settings: Bundle) -> BundleSettings:
    factor = settings.depth_sigma_factor
    return replace(SHARP, depth_sigma_factor=factor, covariance=False, relative_tolerance=TOLERANCE)


def known_points(points: MapPoints, tracks: Tracks, first_feature: Ints) -> Floats:
    """(tracks, 3) positions of the map's points of tracks; NaN for new tracks.

    first_feature (K + 1,): number of the first feature of each keyframe among all.
    """
    found = np.full((tracks.count, 3), np.nan)
    row = first_feature[tracks.frame] + tracks.feature
    old = row < len(points.of_feature)
    number = points.of_feature[row[old]]
    found[tracks.track[old][number >= 0]] = points.points_m[number[number >= 0]]
    return found


def added_uncertainty(T_world_cam: Floats, given: Floats, T_world_given: Floats) -> Floats:
    """(k, 6, 6) covariances of keyframes at (k, 4, 4) due to that of a nearby keyframe.

    given (6, 6): the covariance of that keyframe, at T_world_given (4, 4).
    """
    seen = se3.adjoint(se3.inverse(T_world_cam) @ T_world_given)
    return seen @ given @ np.swapaxes(seen, 1, 2)


def moved_uncertainty(T_before: Floats, T_after: Floats) -> Floats:
    """(k, 6, 6) what the covariances of keyframes grow by if new evidence moves them from (k, 4, 4) to (k, 4, 4).

    The squares of the motion (w, v) in the camera's frame: whatever the covariances were, it is within one standard
    deviation of them then.
    """
    step = se3.inverse(T_before) @ T_after
    motion = np.concatenate([se3.log_so3(step[:, :3, :3]), step[:, :3, 3]], axis=1)
    return np.asarray(motion[:, :, None] * motion[:, None, :], float)
