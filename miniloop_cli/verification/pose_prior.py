"""Rough poses, as a phone's tracking or wheels give them: which pairs are worth comparing, and which edges cannot be.

Only relative poses are used, so that it does not matter in which world they are given. They are never copied into
the result: a frame that the images do not register stays unregistered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from miniloop_cli.config import PosePrior
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.conventions import OPENGL_AXES
from miniloop_cli.graph.visibility import in_view
from miniloop_cli.scene.edge import REJECTED, VERIFIED, Edge, pairs_of
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.typing import Floats, Pair

NEIGHBOURS = 3  # frames after each frame that are compared whatever the poses say
MIN_SHARE = 0.1  # of the points of a scan that must be in view of another
SURE_INLIERS, MIN_SURE, MIN_AGREEING = 20, 5, 0.5


def pairs_by_pose_prior(
    T_world_cam: Floats, points: Sequence[ScanPoints], camera: Camera, settings: PosePrior
) -> list[Pair]:
    """Pairs (i, j), i < j, that may overlap if the poses (n, 4, 4) are off by no more than the tolerance; sorted.

    Frames without a pose (NaN) are compared with all.
    """
    count = len(T_world_cam)
    known = np.isfinite(T_world_cam).all(axis=(1, 2))
    near = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) <= NEIGHBOURS
    near |= ~known[:, None] | ~known
    scans = np.flatnonzero(known)
    depths = np.concatenate([np.zeros(0), *(points[k].points_m[:, 2] for k in scans)])
    if len(depths):
        slack = np.radians(settings.max_deg) + np.arctan(settings.max_m / np.median(depths))
        share = in_view(T_world_cam, scans, points, _widened(camera, slack))
        near[np.ix_(scans, scans)] |= np.maximum(share, share.T) >= MIN_SHARE
    return [(int(i), int(j)) for i, j in np.argwhere(near) if i < j]


def _widened(camera: Camera, slack_rad: float) -> Camera:
    """A camera that sees as much more on every side."""
    margin = round(camera.fx * float(np.tan(min(slack_rad, 1.2))))
    return replace(
        camera,
        cx=camera.cx + margin,
        cy=camera.cy + margin,
        width=camera.width + 2 * margin,
        height=camera.height + 2 * margin,
    )


def reject_by_pose_prior(edges: Sequence[Edge], T_world_cam: Floats, settings: PosePrior) -> list[Edge]:
    """The edges, those rejected that contradict the rough poses beyond the tolerance, the others confirmed by them.

    Raises InputError where most of the edges that are sure by themselves contradict the poses.
    """
    _require_agreement(edges, T_world_cam, settings)
    off = _off(edges, T_world_cam)
    return [_judged(edge, *row, settings) for edge, row in zip(edges, off, strict=True)]


def _judged(edge: Edge, angle_deg: float, distance_m: float, settings: PosePrior) -> Edge:
    if edge.verdict == REJECTED or np.isnan(angle_deg):
        return edge
    if angle_deg > settings.max_deg or distance_m > settings.max_m:
        reason = f"contradicts the rough poses by {angle_deg:.0f} deg, {distance_m:.2f} m"
        return replace(edge, verdict=REJECTED, reason=reason)
    return replace(edge, confirmed=edge.confirmed or edge.inlier_count >= settings.min_bridge_inliers)


def _off(edges: Sequence[Edge], T_world_cam: Floats) -> Floats:
    """(m, 2) degrees and metres between edges and poses; NaN where there is no pose."""
    if not edges:
        return np.zeros((0, 2))
    i, j = pairs_of(edges).T
    off = np.full((len(edges), 2), np.nan)
    known = np.isfinite(T_world_cam[i]).all(axis=(1, 2)) & np.isfinite(T_world_cam[j]).all(axis=(1, 2))
    expected = se3.inverse(T_world_cam[j[known]]) @ T_world_cam[i[known]]
    found = np.array([edge.T_j_i for edge in edges])[known]
    off[known, 0] = se3.rotation_angle_deg(expected[:, :3, :3] @ np.swapaxes(found[:, :3, :3], 1, 2))
    off[known, 1] = np.linalg.norm(expected[:, :3, 3] - found[:, :3, 3], axis=1)
    return off


def _require_agreement(edges: Sequence[Edge], T_world_cam: Floats, settings: PosePrior) -> None:
    """Edges that are sure and move so much that wrong poses would show."""
    sure = [edge for edge in edges if edge.verdict == VERIFIED and edge.inlier_count >= SURE_INLIERS and _tells(edge)]
    share = _agreeing(sure, T_world_cam, settings)
    if len(sure) < MIN_SURE or not share < MIN_AGREEING:
        return
    others = {
        "camera axes x right, y up, z backward (ARKit, OpenGL)": T_world_cam @ OPENGL_AXES,
        "poses world to camera": se3.inverse(T_world_cam),
        "both": se3.inverse(OPENGL_AXES @ T_world_cam),
    }
    best = max(others, key=lambda name: _agreeing(sure, others[name], settings))
    hint = f"they would agree as {best}; " if _agreeing(sure, others[best], settings) > MIN_AGREEING else ""
    raise InputError(
        f"the rough poses contradict {100 * (1 - share):.0f} % of {len(sure)} sure edges by more than "
        f"{settings.max_deg:g} deg or {settings.max_m:g} m; {hint}expected are metres, camera to world, camera axes "
        "x right, y down, z forward (or widen pose_prior.max_deg, pose_prior.max_m)"
    )


def _tells(edge: Edge) -> bool:
    angle = float(se3.rotation_angle_deg(edge.T_j_i[:3, :3]))
    return angle > 10 or float(np.linalg.norm(edge.T_j_i[:3, 3])) > 0.3


def _agreeing(edges: Sequence[Edge], T_world_cam: Floats, settings: PosePrior) -> float:
    off = _off(edges, T_world_cam)
    off = off[np.isfinite(off).all(axis=1)]
    return float((off <= [settings.max_deg, settings.max_m]).all(axis=1).mean()) if len(off) else np.nan
