"""Which edges are believed, and the poses that follow: gate, average the motions, drop what contradicts the result.

Inliers alone do not make an edge true: places look alike, patterns repeat, things move. So the edges are examined
three times: by what else their scans show, before averaging; by what all edges agree on, in averaging; and by what
scans show that came to lie over each other, afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence

from miniloop_cli.averaging.components import average_components
from miniloop_cli.config import Averaging
from miniloop_cli.scene.edge import Edge
from miniloop_cli.scene.poses import Poses, used
from miniloop_cli.verification.consistency_check import Witness
from miniloop_cli.verification.gating import _against, _looked_at, confirmed, examined, without_doubtful


def average(
    edges: Sequence[Edge], count: int, settings: Averaging, witness: Witness | None = None
) -> tuple[Poses, list[Edge]]:
    """Poses of all scans by motion averaging, and the edges, those that were found false rejected with the reason.

    Edges that do not close the loops they lie on do not take part at first. Those that agree with the result of the
    others, or join what the others leave apart, come back; not those of scans that were found to follow what moves.
    """
    witness = witness if settings.min_alike > 0 else None
    edges = examined(edges, witness, settings.min_alike) if witness else list(edges)
    if settings.rotations == "robust":
        first = without_doubtful(edges, count, settings)
        poses, judged, moving = _settled(first, count, settings, witness)
        now = _against(edges, poses, settings)
        back = [
            n if e is not f and not {e.i, e.j} & moving else g
            for e, f, g, n in zip(edges, first, judged, now, strict=True)
        ]
        if not _changed(judged, back):
            return poses, back
        edges = back
    return _settled(edges, count, settings, witness)[:2]


def _settled(
    edges: Sequence[Edge], count: int, settings: Averaging, witness: Witness | None
) -> tuple[Poses, list[Edge], set[int]]:
    """Averaging and dropping what contradicts, repeated until none is dropped (at most five times).

    Also returned: the scans of components that were found not to be one world.
    """
    edges, moving = list(edges), set[int]()
    for _ in range(5):
        edges = confirmed(edges, count, settings.min_alone)
        poses = average_components(used(edges, count), count, settings)
        judged = _against(edges, poses, settings)
        if witness and not _changed(edges, judged):
            judged, moving = _looked_at(judged, poses, witness, settings.min_alike, moving)
        if not _changed(edges, judged):
            return poses, judged, moving
        edges = judged
    edges = confirmed(edges, count, settings.min_alone)
    return average_components(used(edges, count), count, settings), edges, moving


def _changed(before: Sequence[Edge], after: Sequence[Edge]) -> bool:
    return any(a.verdict != b.verdict for a, b in zip(before, after, strict=True))
