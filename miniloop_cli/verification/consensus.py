"""Averaging and judging edges in turn, until the edges and the poses agree.

An edge with many inliers can be false: places look alike, patterns repeat, things move. Edges are therefore checked
three times. Before averaging, the images and depths of their scans are compared. In averaging, each edge is compared
with all others. After averaging, scans that now overlap are compared with each other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from miniloop_cli.averaging.components import average_components
from miniloop_cli.config import Averaging
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.poses import Poses, usable_edges
from miniloop_cli.typing import Bools
from miniloop_cli.verification.gating import (
    check_components,
    check_scans,
    reject_residual_outliers,
    reject_unclosed,
    reject_unsupported_bridges,
)
from miniloop_cli.verification.photometric_check import PhotometricCheck

MAX_ROUNDS = 5


class Stable(NamedTuple):
    """Poses, the judged edges that they come from, and the scans (n,) of components that show no consistent scene."""

    poses: Poses
    edges: EdgeTable
    moving: Bools


def average_verified(
    edges: EdgeTable,
    count: int,
    settings: Averaging,
    photometric: PhotometricCheck | None = None,
    jobs: int = 1,
    compared: Bools | None = None,
) -> tuple[Poses, EdgeTable]:
    """Poses of all scans by motion averaging, and the edges; false ones are rejected with the reason.

    Edges that close no triangles do not take part at first. They return if they agree with the result of the others, or
    join components of it, unless they belong to scans that follow a moving object. `jobs`: threads for large graphs.
    `compared` (m,): edges whose images were compared before, with success.
    """
    photometric = photometric if settings.min_photo_consistency > 0 else None
    if photometric:
        edges = check_scans(edges, photometric, settings.min_photo_consistency, compared)
    if settings.rotations == "robust":
        first = reject_unclosed(edges, count, settings)
        stable = average_until_stable(first, count, settings, photometric, jobs)
        again = reject_residual_outliers(edges, stable.poses, settings)
        held_back = (edges.verdict != first.verdict) & ~stable.moving[edges.i] & ~stable.moving[edges.j]
        back = stable.edges.judged_as(again, held_back)
        if np.array_equal(back.verdict, stable.edges.verdict):
            return stable.poses, back
        edges = back
    stable = average_until_stable(edges, count, settings, photometric, jobs)
    return stable.poses, stable.edges


def average_until_stable(
    edges: EdgeTable, count: int, settings: Averaging, photometric: PhotometricCheck | None, jobs: int = 1
) -> Stable:
    """Average and reject edges that contradict the poses, until none is rejected, at most MAX_ROUNDS times."""
    moving = np.zeros(count, bool)
    for _ in range(MAX_ROUNDS):
        edges = reject_unsupported_bridges(edges, count, settings.min_bridge_inliers)
        poses = average_components(edges.subset(usable_edges(edges, count)), count, settings, jobs)
        judged = reject_residual_outliers(edges, poses, settings)
        if photometric and np.array_equal(judged.verdict, edges.verdict):
            judged, moving = check_components(judged, poses, photometric, settings.min_photo_consistency, moving)
        if np.array_equal(judged.verdict, edges.verdict):
            return Stable(poses, judged, moving)
        edges = judged
    edges = reject_unsupported_bridges(edges, count, settings.min_bridge_inliers)
    poses = average_components(edges.subset(usable_edges(edges, count)), count, settings, jobs)
    return Stable(poses, edges, moving)
