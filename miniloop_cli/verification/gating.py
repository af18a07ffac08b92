"""Which edges are believed: by what their scans show, by the loops they close, by the poses of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from miniloop_cli.config import Averaging
from miniloop_cli.geometry.pose_rows import rows
from miniloop_cli.scene.edge import REJECTED, Edge, pairs_of
from miniloop_cli.scene.poses import Poses, residuals, usable_edges
from miniloop_cli.scene.view_graph import bridges, components
from miniloop_cli.verification.depth_discontinuities import by_outlines
from miniloop_cli.verification.photometric_check import PhotometricCheck, agreement_ratio
from miniloop_cli.verification.triangles import doubtful

# Share of all that the scans of a component see twice that must look alike: else it is not one world. Sound recordings
# have 0.91 and more, poses that follow a walking person 0.44 to 0.78.
MIN_WORLD = 0.75


def reject_unsupported_bridges(edges: Sequence[Edge], count: int, least: int) -> list[Edge]:
    """The edges, those rejected that have fewer than `least` inliers, lie on no loop of used edges, and are not
    confirmed by anything else.
    """
    inside = usable_edges(edges, count)
    few = np.array([edge.inlier_count < least and not edge.confirmed for edge in inside], bool)
    pairs = pairs_of(inside)
    loose = {id(inside[k]) for k in np.flatnonzero(few)[bridges(pairs[few], components(count, pairs[~few]))]}

    def judge(edge: Edge) -> Edge:
        if id(edge) not in loose:
            return edge
        return rejected(edge, f"{edge.inlier_count} inliers, and no loop confirms it")

    return [judge(edge) for edge in edges]


def check_scans(edges: Sequence[Edge], photometric: PhotometricCheck, min_photo_consistency: float) -> list[Edge]:
    """The edges, those rejected that what their scans show speaks against, and those that it cannot confirm."""
    open_edges = [edge for edge in edges if edge.verdict != REJECTED]
    T = np.array([edge.T_j_i for edge in open_edges]).reshape(-1, 4, 4)
    outlined = by_outlines(open_edges, photometric.outline)
    alike = dict(
        zip(map(id, open_edges), agreement_ratio(photometric.votes([(e.i, e.j) for e in open_edges], T)), strict=True)
    )

    def judge(edge: Edge) -> Edge:
        if edge.verdict == REJECTED:
            return edge
        step = min(photometric.step_m[edge.i], photometric.step_m[edge.j])
        if step > 0:
            return rejected(edge, f"both scans repeat themselves (every {step:.2f} m): it may be another part")
        if {edge.i, edge.j} & outlined.keys():
            return rejected(edge, outlined.get(edge.i) or outlined[edge.j])
        if alike[id(edge)] < min_photo_consistency:
            return rejected(edge, f"only {100 * alike[id(edge)]:.0f} % of what both scans see looks alike")
        return edge

    return [judge(edge) for edge in edges]


def reject_unclosed(edges: Sequence[Edge], count: int, settings: Averaging) -> list[Edge]:
    """The edges, those rejected that close hardly any of the loops of three they lie on, where other edges do."""
    inside = usable_edges(edges, count)
    if not inside:
        return list(edges)
    pairs, T_j_i = pairs_of(inside), np.array([e.T_j_i for e in inside])
    near = (float(np.cos(np.radians(settings.max_residual_deg) / 2)), settings.max_residual_m**2)
    out = {id(e) for e, doubted in zip(inside, doubtful(count, pairs, rows(T_j_i), near), strict=True) if doubted}
    return [rejected(edge, "closes no loops") if id(edge) in out else edge for edge in edges]


def rejected(edge: Edge, reason: str) -> Edge:
    """The edge, rejected for a reason; the one it was rejected for before stands."""
    return edge if edge.verdict == REJECTED else replace(edge, verdict=REJECTED, reason=reason)


def check_components(
    edges: Sequence[Edge], poses: Poses, photometric: PhotometricCheck, min_photo_consistency: float, moving: set[int]
) -> tuple[list[Edge], set[int]]:
    """The edges, those rejected whose scans, by their poses, lie over others that look different; and what moves.

    If that is true of a whole component, its edges follow something that moves, or a pattern, and its scans join those
    known to be `moving`; if it is true of a scan, the edges of this scan are wrong. If most scans are of the first
    kind, none is believed: the few others may follow it, too.
    """
    reason: dict[int, str] = {}
    for component in range(poses.component.max(initial=-1) + 1):
        scans = np.flatnonzero(poses.component == component)
        pairs, T_j_i = photometric.neighbours(poses.T_world_cam, scans)
        said = photometric.votes(pairs, T_j_i)
        if agreement_ratio(said.sum(axis=0)) < MIN_WORLD:
            part = f"{100 * agreement_ratio(said.sum(axis=0)):.0f} % of what {len(scans)} scans see twice looks alike"
            moving = moving | set(scans.tolist())
            reason |= dict.fromkeys(scans.tolist(), f"only {part}: something moves, or places were confused")
            continue
        of_scan = np.zeros((len(poses.component), 2), np.int64)
        for pair, row in zip(pairs, said, strict=True):
            of_scan[list(pair)] += row
        for scan in scans[agreement_ratio(of_scan[scans]) < min_photo_consistency]:
            part = f"{100 * agreement_ratio(of_scan[scan]):.0f} % of what it shares with its neighbours looks alike"
            reason[int(scan)] = f"scan {scan}: only {part}"
    rest = set(np.flatnonzero(poses.component >= 0).tolist()) - moving
    if len(moving) > len(rest):
        why = f"{len(moving)} other scans, more than are left, are not one world"
        reason |= dict.fromkeys(rest - reason.keys(), why)
    judged = [rejected(e, reason.get(e.i) or reason[e.j]) if {e.i, e.j} & reason.keys() else e for e in edges]
    return judged, moving


def reject_residual_outliers(edges: Sequence[Edge], poses: Poses, settings: Averaging) -> list[Edge]:
    """The edges, those rejected that contradict the poses of their component."""
    component = poses.component

    def judge(edge: Edge, angle: float, distance: float) -> Edge:
        if edge.verdict == REJECTED or component[edge.i] < 0 or component[edge.i] != component[edge.j]:
            return edge
        if angle <= settings.max_residual_deg and distance <= settings.max_residual_m:
            return edge
        return rejected(edge, f"contradicts the others by {angle:.1f} deg, {100 * distance:.0f} cm")

    return list(map(judge, edges, *residuals(edges, poses.T_world_cam)))
