"""Adjustment of new keyframes to a map: first with the keyframes that share their points, then all for a few steps.

The map is at its minimum. A new recording mostly affects its own keyframes and their neighbours: these are adjusted
while the others keep their poses. The remaining forces on the whole are small, so a few steps of all poses and points
suffice, without new matches.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from miniloop_cli.config import Bundle
from miniloop_cli.geometry import se3
from miniloop_cli.refinement.bundle import BundleResult, BundleSettings, bundle_adjust
from miniloop_cli.refinement.joint import MIN_SHARED, SHARP, six_digits
from miniloop_cli.refinement.tracks import Tracks
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.scene_map import MapPoints
from miniloop_cli.typing import Bools, Floats, Ints

ROUNDING = np.radians(0.02), 0.0005  # rad, m
WHOLE_STEPS, WHOLE_TOLERANCE = 8, 1e-6  # of all poses together, from nearly correct poses


class Locally(NamedTuple):
    """Poses (K, 4, 4), points (p, 3), and which keyframes (K,) were adjusted."""

    T_world_cam: Floats
    points: Floats
    active: Bools


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
        self, T: Floats, scans: ScanSet, settings: BundleSettings, jobs: int, held: Bools, points: Floats | None
    ) -> BundleResult:
        """The poses, from T (n, 4, 4), and points (p, 3) that fit best; held (n,) marks fixed poses."""
        return bundle_adjust(
            T, self.frame, self.track, self.px_ideal, self.z_m, scans.camera, settings, jobs, points, held=held
        )


def shared_tracks(seen: Observations, new: Bools) -> Ints:
    """(K,) number of tracks of each keyframe that the `new` ones (K,) also see."""
    counts: Ints = np.bincount(seen.of_tracks_seen_by(new).frame, minlength=len(new))
    return counts


def adjusted_locally(
    T_world_cam: Floats, seen: Observations, new: Bools, scans: ScanSet, settings: Bundle, jobs: int
) -> Locally:
    """Adjust the `new` keyframes (K,) and those that share points with them; the others are fixed."""
    active: Bools = new | (shared_tracks(seen, new) >= MIN_SHARED)
    part = seen.of_tracks_seen_by(active)
    rough = BundleSettings(depth_sigma_factor=settings.depth_sigma_factor, relative_tolerance=1e-3, covariance=False)
    first = part.adjusted(T_world_cam, scans, rough, jobs, ~active, None)
    last = part.adjusted(first.T_world_cam, scans, _fine(settings), jobs, ~active, first.points_world)
    return Locally(last.T_world_cam, last.points_world, active)


def adjusted_together(
    T_world_cam: Floats, points: Floats, seen: Observations, fixed: int, scans: ScanSet, settings: Bundle, jobs: int
) -> tuple[Floats, Floats]:
    """All poses (K, 4, 4) and points (p, 3) after a few steps; keyframe `fixed` keeps its pose.

    points (p, 3): NaN where unknown.
    """
    kind = replace(_fine(settings), max_iterations=WHOLE_STEPS, relative_tolerance=WHOLE_TOLERANCE, fixed_frame=fixed)
    nobody = np.zeros(len(T_world_cam), bool)
    found = seen.adjusted(T_world_cam, scans, kind, jobs, nobody, points)
    # The last bits depend on how this process compiled the kernels; rounding to a nanometre gives the same bytes.
    return np.round(found.T_world_cam, 9) + 0.0, found.points_world


def covariance_beside_the_map(
    T_world_cam: Floats, points: Floats, seen: Observations, new: Bools, scans: ScanSet, settings: Bundle, jobs: int
) -> Floats:
    """(k, 6, 6) covariances of the `new` keyframes (K,) at the minimum, given all others."""
    kind = replace(_fine(settings), covariance=True, max_iterations=0)
    found = seen.of_tracks_seen_by(new).adjusted(T_world_cam, scans, kind, jobs, ~new, points)
    assert found.covariance is not None
    return six_digits(found.covariance[new])


def _fine(settings: Bundle) -> BundleSettings:
    return replace(SHARP, depth_sigma_factor=settings.depth_sigma_factor, covariance=False)


def known_points(points: MapPoints, tracks: Tracks, first_feature: Ints) -> Floats:
    """(tracks, 3) positions of the map's points of tracks; NaN for new tracks."""
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


def surprise(T_before: Floats, T_after: Floats, covariance: Floats) -> Floats:
    """(k,) chi-squared of the motion of keyframes (k, 4, 4) under covariances (k, 6, 6), 6 degrees of freedom.

    Motions within ROUNDING count as zero.
    """
    E = se3.inverse(T_before) @ T_after
    xi = np.concatenate([se3.log_so3(E[:, :3, :3]), E[:, :3, 3]], axis=1)
    floor = np.diag(np.repeat(np.array(ROUNDING) ** 2, 3))
    finite = np.atleast_1d(np.isfinite(covariance).all(axis=(1, 2)))
    known = np.where(finite[:, None, None], covariance, np.eye(6))
    return np.einsum("ki,ki->k", xi, np.linalg.solve(known + floor, xi[..., None])[..., 0])
