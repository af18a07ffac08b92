"""Averaging and judging edges in turn, until the edges and the poses agree.

Inliers alone do not make an edge true: places look alike, patterns repeat, things move. So edges are checked three
times: by what else their scans show, before averaging; by what all edges agree on, in averaging; and by what the scans
show that came to lie over each other, afterwards.
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
    """Poses, the judged edges they rest on, and the scans (n,) of components that are not one world."""

    poses: Poses
    edges: EdgeTable
    moving: Bools


def average_verified(
    edges: EdgeTable, count: int, settings: Averaging, photometric: PhotometricCheck | None = None
) -> tuple[Poses, EdgeTable]:
    """Poses of all scans by motion averaging, and the edges, those found false rejected with the reason.

    Edges that close no triangles do not take part at first. Those that agree with the result of the others, or join
    what the others leave apart, come back; not those of scans that follow what moves.
    """
    photometric = photometric if settings.min_photo_consistency > 0 else None
    if photometric:
        edges = check_scans(edges, photometric, settings.min_photo_consistency)
    if settings.rotations == "robust":
        first = reject_unclosed(edges, count, settings)
        stable = average_until_stable(first, count, settings, photometric)
        again = reject_residual_outliers(edges, stable.poses, settings)
        held_back = (edges.verdict != first.verdict) & ~stable.moving[edges.i] & ~stable.moving[edges.j]
        back = stable.edges.judged_as(again, held_back)
        if np.array_equal(back.verdict, stable.edges.verdict):
            return stable.poses, back
        edges = back
    stable = average_until_stable(edges, count, settings, photometric)
    return stable.poses, stable.edges


def average_until_stable(
    edges: EdgeTable, count: int, settings: Averaging, photometric: PhotometricCheck | None
) -> Stable:
    """Average and reject what contradicts the poses, until nothing is rejected, at most MAX_ROUNDS times."""
    moving = np.zeros(count, bool)
    for _ in range(MAX_ROUNDS):
        edges = reject_unsupported_bridges(edges, count, settings.min_bridge_inliers)
        poses = average_components(edges.subset(usable_edges(edges, count)), count, settings)
        judged = reject_residual_outliers(edges, poses, settings)
        if photometric and np.array_equal(judged.verdict, edges.verdict):
            judged, moving = check_components(judged, poses, photometric, settings.min_photo_consistency, moving)
        if np.array_equal(judged.verdict, edges.verdict):
            return Stable(poses, judged, moving)
        edges = judged
    edges = reject_unsupported_bridges(edges, count, settings.min_bridge_inliers)
    return Stable(average_components(edges.subset(usable_edges(edges, count)), count, settings), edges, moving)
