"""The gauge: with relative measurements, every connected group of frames can move as a whole.

With terms that measure the vertical, its position and heading are free; with terms that measure poses in the world,
nothing is.

The descent holds no frame fixed: the damping alone keeps the equations regular. This converges in far fewer steps than
with one fixed frame, whose neighbourhood must then turn. Afterwards each group is moved so that its anchor has its
original pose.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.refinement.terms import Gauge, PoseTerm
from miniloop_cli.scene.view_graph import components
from miniloop_cli.typing import Bools, Floats, Ints


def anchor_of(count: int, pairs: Ints, fixed_frame: int, held: Bools | None = None) -> Ints:
    """(count,) the frame that keeps its pose in each frame's group: `fixed_frame` in its own, elsewhere the first.

    pairs (m, 2) of frames that measurements join. Frames that are `held` (count,) are their own anchors; one of them is
    the anchor of the others in their group.
    """
    labels = components(count, pairs)
    _, first = np.unique(labels, return_index=True)
    held = np.zeros(count, bool) if held is None else held
    kept = np.flatnonzero(held)
    first[labels[kept]] = kept
    first[labels[fixed_frame]] = fixed_frame
    return np.where(held, np.arange(count), first[labels])


def restoring_motion(T_given: Floats, T_refined: Floats, anchor: Ints, terms: Sequence[PoseTerm] = ()) -> Floats:
    """(n, 4, 4) motion of each frame's group that restores the given pose of its anchor, as far as the gauge is free.

    T_given and T_refined (n, 4, 4), anchor (n,) of `anchor_of`. If the vertical of a group is measured, position and
    heading of the anchor are restored; if poses in the world are measured, nothing is.
    """
    motion = T_given[anchor] @ se3.inverse(T_refined[anchor])
    free = np.full(len(anchor), int(Gauge.POSE))
    for term in terms:
        np.minimum.at(free, anchor[term.frames.ravel()], int(term.gauge))
    free = free[anchor]
    level = free == Gauge.HEADING
    if level.any():
        R = motion[level, :3, :3]
        heading = np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])  # of the turn about z nearest to R
        turn = se3.exp_so3(heading[:, None] * [0.0, 0.0, 1.0])
        given, refined = T_given[anchor][level, :3, 3], T_refined[anchor][level, :3, 3]
        motion[level] = se3.pose(turn, given - np.einsum("nij,nj->ni", turn, refined))
    motion[free == Gauge.NOTHING] = np.eye(4)
    return motion


def with_untied(covariance: Floats, anchor: Ints, fixed_frame: int, held: Bools | None = None) -> Floats:
    """The covariances (n, 6, 6), infinite for frames not joined to the fixed one, or to one that is `held` (n,).

    anchor (n,) of `anchor_of`.
    """
    untied = anchor != fixed_frame
    if held is not None:
        untied &= ~held[anchor]
    return np.where(untied[:, None, None], np.diag(np.full(6, np.inf)) if untied.any() else 0.0, covariance)


def with_own_errors(covariance: Floats, T_world_cam: Floats, own: Floats, fixed_frame: int) -> Floats:
    """Covariances (n, 6, 6) relative to the fixed frame, plus the `own` errors (n, 6, 6) of each frame.

    All are of (w, v) in the frame. The fixed frame has covariance zero by definition: its own error is added to all
    others.
    """
    seen = se3.adjoint(se3.inverse(T_world_cam) @ T_world_cam[fixed_frame])
    more = own + seen @ own[fixed_frame] @ np.swapaxes(seen, 1, 2)
    more[fixed_frame] = 0
    tied = np.all(np.isfinite(covariance), axis=(1, 2))
    return np.where(tied[:, None, None], covariance + more, covariance)
