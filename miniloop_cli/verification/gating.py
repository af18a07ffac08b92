"""Checks that accept or reject edges: by images and depths, by the loops they close, by the poses of all scans."""

from __future__ import annotations

import numpy as np

from miniloop_cli.config import Averaging
from miniloop_cli.geometry.pose_rows import rows
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses, residuals, usable_edges
from miniloop_cli.scene.verdict import Rejection
from miniloop_cli.scene.view_graph import bridges, components
from miniloop_cli.typing import Bools
from miniloop_cli.verification.depth_discontinuities import share_on_discontinuities
from miniloop_cli.verification.photometric_check import PhotometricCheck, agreement_ratio
from miniloop_cli.verification.triangles import doubtful

# Smallest share of agreeing cells among all that the scans of a component see twice; with less, it shows no consistent
# scene. Correct poses give 0.91 and more, poses that follow a walking person 0.44 to 0.78.
MIN_WORLD = 0.75


def reject_unsupported_bridges(edges: EdgeTable, count: int, least: int) -> EdgeTable:
    """Reject edges that have fewer than `least` inliers, lie on no loop of usable edges, and are not confirmed."""
    usable = usable_edges(edges, count)
    few = usable & (edges.inlier_count < least) & ~edges.confirmed
    rows_of_few = np.flatnonzero(few)
    pieces = components(count, edges.pairs[usable & ~few])
    alone = np.zeros(len(edges), bool)
    alone[rows_of_few[bridges(edges.pairs[rows_of_few], pieces)]] = True
    return edges.reject(alone, Rejection.UNSUPPORTED_BRIDGE, edges.inlier_count)


def check_scans(
    edges: EdgeTable, photometric: PhotometricCheck, min_photo_consistency: float, compared: Bools | None = None
) -> EdgeTable:
    """Reject edges that the images and depths of their scans contradict or cannot confirm.

    `compared` (m,): edges whose images were compared before, with success; they are not compared again.
    """
    rows_open = np.flatnonzero(edges.open)
    ratio, unseen = np.ones(len(edges)), rows_open if compared is None else np.flatnonzero(edges.open & ~compared)
    ratio[unseen] = agreement_ratio(photometric.votes(edges.pairs[unseen], edges.T_j_i[unseen]))
    on_edges = share_on_discontinuities(edges.subset(rows_open), photometric.outline)
    step_m = np.asarray(photometric.step_m, float)
    step = np.minimum(step_m[edges.i], step_m[edges.j])
    placed = np.where(on_edges[edges.i] > 0, edges.i, edges.j)

    edges = edges.reject(step > 0, Rejection.REPETITION, step)
    edges = edges.reject(on_edges[placed] > 0, Rejection.DEPTH_DISCONTINUITIES, placed, on_edges[placed])
    return edges.reject(ratio < min_photo_consistency, Rejection.LOOKS_DIFFERENT, ratio)


def reject_unclosed(edges: EdgeTable, count: int, settings: Averaging) -> EdgeTable:
    """Reject edges that close hardly any of the triangles they lie on, where other edges do."""
    usable = np.flatnonzero(usable_edges(edges, count))
    near = (float(np.cos(np.radians(settings.max_residual_deg) / 2)), settings.max_residual_m**2)
    unclosed = np.zeros(len(edges), bool)
    if len(usable):
        unclosed[usable] = doubtful(count, edges.pairs[usable], rows(edges.T_j_i[usable]), near)
    return edges.reject(unclosed, Rejection.UNCLOSED_TRIANGLES)


def check_components(
    edges: EdgeTable, poses: Poses, photometric: PhotometricCheck, min_photo_consistency: float, moving: Bools
) -> tuple[EdgeTable, Bools]:
    """Reject edges of scans that look different from others which they overlap by their poses; return moving scans.

    If a whole component looks different, its edges follow a moving object or a pattern, and its scans join the `moving`
    ones (n,). If one scan looks different, its edges are wrong. If most scans are moving, no edge is accepted, as the
    remaining scans may follow a moving object as well.
    """
    count = len(poses.component)
    why, detail, moving = np.zeros(count, np.int64), np.zeros((count, 2)), moving.copy()
    for component in range(poses.component.max(initial=-1) + 1):
        scans = np.flatnonzero(poses.component == component)
        pairs, T_j_i = photometric.neighbours(poses.T_world_cam, scans)
        votes = photometric.votes(pairs, T_j_i)
        together = float(agreement_ratio(votes.sum(axis=0)))
        if together < MIN_WORLD:
            moving[scans] = True
            why[scans], detail[scans] = Rejection.MOVING_COMPONENT, (together, len(scans))
            continue
        of_scan = np.zeros((count, 2), np.int64)
        for end in range(2):
            np.add.at(of_scan, pairs[:, end], votes)
        ratio = agreement_ratio(of_scan)
        different = scans[ratio[scans] < min_photo_consistency]
        why[different] = Rejection.SCAN_LOOKS_DIFFERENT
        detail[different] = np.stack([different, ratio[different]], axis=1)
    rest = (poses.component >= 0) & ~moving
    if moving.sum() > rest.sum():
        rest &= why == Rejection.NONE
        why[rest], detail[rest] = Rejection.MOSTLY_MOVING, (moving.sum(), 0)
    scan = np.where(why[edges.i] != Rejection.NONE, edges.i, edges.j)
    for reason in np.unique(why[why != Rejection.NONE]):
        edges = edges.reject(why[scan] == reason, Rejection(int(reason)), *detail[scan].T)
    return edges, moving


def reject_residual_outliers(edges: EdgeTable, poses: Poses, settings: Averaging) -> EdgeTable:
    """Reject edges that contradict the poses of their component."""
    component = poses.component
    same = (component[edges.i] >= 0) & (component[edges.i] == component[edges.j])
    angle_deg, distance_m = residuals(edges, poses.T_world_cam)
    off = (angle_deg > settings.max_residual_deg) | (distance_m > settings.max_residual_m)
    return edges.reject(same & off, Rejection.CONTRADICTS_POSES, angle_deg, distance_m)
