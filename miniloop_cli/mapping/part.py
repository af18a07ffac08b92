"""The part of a map for a registered recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.depth_model import rho
from miniloop_cli.refinement.timing import Measurements, corrected, flow
from miniloop_cli.scene.calibration import Calibration
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.poses import usable_edges
from miniloop_cli.scene.registration import Registration
from miniloop_cli.scene.scene_map import MapPart
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Floats, Ints

MAP_FEATURES = 1200  # largest number for a keyframe: with their descriptors they fit in 200 kB


def part_of(run: Registration, feature_type: str) -> MapPart:
    """The registered frames of a run, and data of its keyframes to compare with other recordings and images."""
    frame = run.poses.registered
    scans = np.intersect1d(frame, run.scan_frames)
    edges = run.edges.subset(usable_edges(run.edges, len(run.scans)) & run.poses.joins(run.edges))
    uses = feature_uses(edges, [len(scan.features) for scan in run.scans])
    rows, features = [], []
    for k in scans.tolist():
        scan, sequence = by_calibration(run.scans[k].features, run.calibration), run.sequence
        lag_s = float(sequence.depth_stamps_s[k] - sequence.stamps_s[k])
        velocity = np.zeros(6) if run.velocity is None else run.velocity[k]
        still = at_one_instant(scan, velocity, run.timing, lag_s, sequence.camera)
        row = chosen_features(still, uses[k])
        rows.append(row)
        features.append(of_rows(still, row))
    return MapPart(
        run.sequence.name,
        str(run.sequence.root),
        run.sequence.layout,
        len(run.sequence.frames),
        run.sequence.camera,
        feature_type,
        run.timing,
        frame,
        run.sequence.stamps_s[frame],
        run.poses.T_world_cam[frame],
        run.covariance[frame],
        np.searchsorted(frame, scans),
        tuple(run.sequence.frames[k].color.fingerprint()[:16] for k in scans.tolist()),
        tuple(features),
        tuple(run.scans[k].view for k in scans.tolist()),
        between_rows(edges, scans, rows).rounded(),
    )


def feature_uses(edges: EdgeTable, counts: list[int]) -> list[Ints]:
    """For each scan, the number of edges in which each of its features (count,) is an inlier."""
    uses = [np.zeros(count, np.int64) for count in counts]
    for e in range(len(edges)):
        rows = edges.inlier_rows(e)
        uses[edges.i[e]][rows[:, 0]] += 1
        uses[edges.j[e]][rows[:, 1]] += 1
    return uses


def chosen_features(features: ScanFeatures, uses: Ints, most: int = MAP_FEATURES) -> Ints:
    """Rows (k,) to keep: features with depth, first those with most `uses` (n,), then the strongest."""
    usable = np.flatnonzero(np.isfinite(features.z_m))
    order = usable[np.argsort(-uses[usable], kind="stable")]
    return np.sort(order[:most])


def of_rows(features: ScanFeatures, rows: Ints) -> ScanFeatures:
    """The features of ascending rows (k,)."""
    f = features
    places = f.px[rows], f.px_ideal[rows], f.z_m[rows], f.slope[rows]
    return ScanFeatures(*places, f.outline[rows], f.descriptors[rows])


def by_calibration(features: ScanFeatures, calibration: Calibration | None) -> ScanFeatures:
    """Features in the calibrated camera; they were extracted with the given one."""
    if calibration is None or not calibration.changed or calibration.beforehand:
        return features
    camera = calibration.camera
    px_ideal = camera.undistort(calibration.given.distort(features.px_ideal))
    z_m = features.z_m + calibration.parameters.depth_step(features.z_m, rho(features.px, camera.width, camera.height))
    lost = ~np.isfinite(px_ideal).all(axis=1) | ~(z_m > 0)
    px_ideal[lost] = features.px_ideal[lost]
    return replace(features, px_ideal=px_ideal, z_m=np.where(lost, np.nan, z_m))


def at_one_instant(
    features: ScanFeatures, velocity: Floats, timing: Timing, stamp_lag_s: float, camera: Camera
) -> ScanFeatures:
    """Features corrected to the time of the middle row for image and depth, by `refinement.timing.corrected`.

    velocity (6,): (w, v) rad/s and m/s of the camera in its own frame; stamp_lag_s: depth stamp minus colour stamp.
    Features without depth stay as they are.
    """
    if timing == Timing() or not velocity.any():
        return features
    n = len(features)
    measured = Measurements(
        np.zeros(n, np.int64),
        np.arange(n),
        (features.px[:, 1] - (camera.height - 1) / 2) / camera.height,
        features.px_ideal,
        features.z_m,
        features.slope,
        np.full(n, stamp_lag_s),
    )
    known = np.isfinite(features.z_m)
    moving = flow(measured, np.where(known, features.z_m, 1.0), velocity[None, 3:], velocity[None, :3], camera)
    px, z_m = corrected(measured, moving, timing, camera)
    return replace(features, px_ideal=np.where(known[:, None], px, features.px_ideal), z_m=np.where(known, z_m, np.nan))


def between_rows(edges: EdgeTable, scans: Ints, rows: list[Ints]) -> EdgeTable:
    """The edges among scans (k,), renumbered by them, with the inliers among the kept rows (f,) of each scan."""
    edges = edges.subset(np.isin(edges.i, scans) & np.isin(edges.j, scans))
    i, j = np.searchsorted(scans, edges.i), np.searchsorted(scans, edges.j)
    matches = []
    for e in range(len(edges)):
        pair = edges.inlier_rows(e)
        ends = [np.searchsorted(rows[k], pair[:, side]) for side, k in enumerate((i[e], j[e]))]
        found = [
            (end < len(rows[k])) & (rows[k][np.minimum(end, len(rows[k]) - 1)] == pair[:, side])
            if len(rows[k])
            else np.zeros(len(pair), bool)
            for side, (end, k) in enumerate(zip(ends, (i[e], j[e]), strict=True))
        ]
        matches.append(np.stack(ends, axis=1)[found[0] & found[1]])
    counts = np.array([len(part) for part in matches], np.int64)
    return replace(
        edges,
        i=i,
        j=j,
        start=np.concatenate([np.zeros(1, np.int64), np.cumsum(counts)]),
        matches=np.concatenate([np.zeros((0, 2), np.int64), *matches]),
        inliers=np.ones(int(counts.sum()), bool),
    )
