"""Which edges are believed, and the poses that follow: gate, average the motions, drop what contradicts the result.

Inliers alone do not make an edge true: places look alike, patterns repeat, things move. So the edges are check_scans
three times: by what else their scans show, before averaging; by what all edges agree on, in averaging; and by what
scans show that came to lie over each other, afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence

from miniloop_cli.averaging.components import average_components
from miniloop_cli.config import Averaging
from miniloop_cli.scene.edge import Edge
from miniloop_cli.scene.poses import Poses, usable_edges
from miniloop_cli.verification.gating import (
    check_components,
    check_scans,
    reject_residual_outliers,
    reject_unclosed,
    reject_unsupported_bridges,
)
from miniloop_cli.verification.photometric_check import PhotometricCheck


def average(
    edges: Sequence[Edge], count: int, settings: Averaging, photometric: PhotometricCheck | None = None
) -> tuple[Poses, list[Edge]]:
    """Poses of all scans by motion averaging, and the edges, those that were found false rejected with the reason.

    Edges that do not close the loops they lie on do not take part at first. Those that agree with the result of the
    others, or join what the others leave apart, come back; not those of scans that were found to follow what moves.
    """
    photometric = photometric if settings.min_photo_consistency > 0 else None
    edges = check_scans(edges, photometric, settings.min_photo_consistency) if photometric else list(edges)
    if settings.rotations == "robust":
        first = reject_unclosed(edges, count, settings)
        poses, judged, moving = average_until_stable(first, count, settings, photometric)
        now = reject_residual_outliers(edges, poses, settings)
        back = [
            n if e is not f and not {e.i, e.j} & moving else g
            for e, f, g, n in zip(edges, first, judged, now, strict=True)
        ]
        if not _changed(judged, back):
            return poses, back
        edges = back
    return average_until_stable(edges, count, settings, photometric)[:2]


def average_until_stable(
    edges: Sequence[Edge], count: int, settings: Averaging, photometric: PhotometricCheck | None
) -> tuple[Poses, list[Edge], set[int]]:
    """Averaging and dropping what contradicts, repeated until none is dropped (at most five times).

    Also returned: the scans of components that were found not to be one world.
    """
    edges, moving = list(edges), set[int]()
    for _ in range(5):
        edges = reject_unsupported_bridges(edges, count, settings.min_bridge_inliers)
        poses = average_components(usable_edges(edges, count), count, settings)
        judged = reject_residual_outliers(edges, poses, settings)
        if photometric and not _changed(edges, judged):
            judged, moving = check_components(judged, poses, photometric, settings.min_photo_consistency, moving)
        if not _changed(edges, judged):
            return poses, judged, moving
        edges = judged
    edges = reject_unsupported_bridges(edges, count, settings.min_bridge_inliers)
    return average_components(usable_edges(edges, count), count, settings), edges, moving


def _changed(before: Sequence[Edge], after: Sequence[Edge]) -> bool:
    return any(a.verdict != b.verdict for a, b in zip(before, after, strict=True))
