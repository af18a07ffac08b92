"""Rough poses, as from a phone's tracking or wheel odometry: which pairs to compare, and which edges to reject.

Only relative poses are used, so their world frame is arbitrary. They are never copied into the result: a frame that the
images do not register stays unregistered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from miniloop_cli.config import PosePrior
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.conventions import CONVENTIONS
from miniloop_cli.graph.visibility import pairs_in_view
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.verdict import Rejection
from miniloop_cli.typing import Bools, Floats, Pair

NEIGHBOURS = 3  # frames after each frame that are always compared
MIN_SHARE = 0.1  # of the points of a scan that must be in view of another
SURE_INLIERS, MIN_SURE, MIN_AGREEING = 20, 5, 0.5


def pairs_by_pose_prior(
    T_world_cam: Floats, points: Sequence[ScanPoints], camera: Camera, settings: PosePrior
) -> list[Pair]:
    """Pairs (i, j), i < j, that may overlap if the errors of the poses (n, 4, 4) are within the tolerance; sorted.

    Frames without a pose (NaN) are compared with all.
    """
    count = len(T_world_cam)
    known = np.all(np.isfinite(T_world_cam), axis=(1, 2))
    pairs = {(i, j) for i in range(count) for j in range(i + 1, min(i + NEIGHBOURS + 1, count))}
    pairs |= {(min(i, j), max(i, j)) for i in np.flatnonzero(~known).tolist() for j in range(count) if i != j}
    scans = np.flatnonzero(known)
    depths = np.concatenate([np.zeros(0), *(points[int(k)].points_m[:, 2] for k in scans)])
    if len(depths):
        slack = np.radians(settings.max_deg) + np.arctan(settings.max_m / np.median(depths))
        pairs |= pairs_in_view(T_world_cam, scans, points, _widened(camera, slack), MIN_SHARE)
    return sorted(pairs)


def _widened(camera: Camera, slack_rad: float) -> Camera:
    """A camera with a view that is larger by `slack_rad` on every side."""
    margin = round(camera.fx * float(np.tan(min(slack_rad, 1.2))))
    return replace(
        camera,
        cx=camera.cx + margin,
        cy=camera.cy + margin,
        width=camera.width + 2 * margin,
        height=camera.height + 2 * margin,
    )


def reject_by_pose_prior(edges: EdgeTable, T_world_cam: Floats, settings: PosePrior) -> EdgeTable:
    """Reject edges that contradict the prior poses T_world_cam (n, 4, 4); confirm the others with enough inliers.

    Raises InputError where most of the edges that are sure by themselves contradict the prior.
    """
    _require_agreement(edges, T_world_cam, settings)
    angle_deg, distance_m = _off(edges, T_world_cam).T
    off = (angle_deg > settings.max_deg) | (distance_m > settings.max_m)
    agrees = edges.open & np.isfinite(angle_deg) & ~off & (edges.inlier_count >= settings.min_bridge_inliers)
    judged = edges.reject(off, Rejection.CONTRADICTS_POSE_PRIOR, angle_deg, distance_m)
    return replace(judged, confirmed=judged.confirmed | agrees)


def _off(edges: EdgeTable, T_world_cam: Floats) -> Floats:
    """(m, 2) degrees and metres between edges and poses; NaN where there is no pose."""
    i, j, off = edges.i, edges.j, np.full((len(edges), 2), np.nan)
    known = np.isfinite(T_world_cam[i]).all(axis=(1, 2)) & np.isfinite(T_world_cam[j]).all(axis=(1, 2))
    expected, found = se3.inverse(T_world_cam[j[known]]) @ T_world_cam[i[known]], edges.T_j_i[known]
    off[known, 0] = se3.rotation_angle_deg(expected[:, :3, :3] @ np.swapaxes(found[:, :3, :3], 1, 2))
    off[known, 1] = np.linalg.norm(expected[:, :3, 3] - found[:, :3, 3], axis=1)
    return off


def _require_agreement(edges: EdgeTable, T_world_cam: Floats, settings: PosePrior) -> None:
    """Raise InputError if sure edges, with enough motion to show wrong poses, contradict the prior."""
    sure = edges.subset(edges.verified & (edges.inlier_count >= SURE_INLIERS) & _tells(edges))
    share = _agreeing(sure, T_world_cam, settings)
    if len(sure) < MIN_SURE or not share < MIN_AGREEING:
        return
    known = np.isfinite(T_world_cam).all(axis=(1, 2))
    others = {}
    for convention in CONVENTIONS.values():
        for unit, per_m in (("", 1.0), (", in millimetres", 1000.0)):
            T = T_world_cam.copy()
            T[known] = convention.ours(T_world_cam[known])
            T[:, :3, 3] /= per_m
            others[convention.words + unit] = T
    best = max(others, key=lambda name: _agreeing(sure, others[name], settings))
    hint = f"read as {best}, it agrees; " if _agreeing(sure, others[best], settings) > MIN_AGREEING else ""
    raise InputError(
        f"the pose prior contradicts {100 * (1 - share):.0f} % of {len(sure)} sure edges by more than "
        f"{settings.max_deg:g} deg or {settings.max_m:g} m; {hint}give metres, camera to world, camera axes "
        "x right, y down, z forward, or raise pose_prior.max_deg and pose_prior.max_m"
    )


def _tells(edges: EdgeTable) -> Bools:
    """(m,) whether an edge moves enough to show a wrong prior."""
    return (se3.rotation_angle_deg(edges.T_j_i[:, :3, :3]) > 10) | (np.linalg.norm(edges.T_j_i[:, :3, 3], axis=1) > 0.3)


def _agreeing(edges: EdgeTable, T_world_cam: Floats, settings: PosePrior) -> float:
    off = _off(edges, T_world_cam)
    off = off[np.isfinite(off).all(axis=1)]
    return float((off <= [settings.max_deg, settings.max_m]).all(axis=1).mean()) if len(off) else np.nan
