"""The certificate of averaging: whether other poses can fit the edges better."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from miniloop_cli.geometry.procrustes import align_rotations
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.sequence import Note, NoteKind


@dataclass(frozen=True)
class Certificate:
    """Whether other poses could fit the edges of a pose graph, with the same weights, better; for all components.

    `optimum`: the poses of least cost that were found; `relative_gap`: the least possible cost is lower by no more than
    this share, NaN if it was not computed for the reason `problem`. `escaped`: averaging had ended in another, worse
    minimum. `moved_m`: by how much the refinement then moved frames (median), NaN before it.
    """

    certified: bool
    relative_gap: float
    optimum: Poses
    escaped: bool = False
    problem: str = ""
    moved_m: float = float("nan")

    @property
    def sentence(self) -> str:
        """The certificate in words."""
        if self.problem:
            return f"it is not known whether another arrangement of the edges is better: {self.problem}"
        percent = np.format_float_positional(100 * self.relative_gap, precision=2, fractional=False, trim="-") + " %"
        if not self.certified:
            return f"another arrangement of the same edges and weights may be better, by up to {percent}"
        better = f"better by more than {percent}" if self.relative_gap > 0 else "better"
        moved = ""
        if np.isfinite(self.moved_m):
            moved = f"; the refinement then moved frames by {1000 * self.moved_m:.1f} mm (median)"
        return f"no other arrangement of these edges and weights is {better}{moved}"

    @property
    def note(self) -> Note:
        """The sentence as a note, which makes the result doubtful if better poses may exist."""
        return Note(NoteKind.PROVEN if self.certified or self.problem else NoteKind.UNPROVEN, self.sentence)

    def refined(self, poses: Poses) -> Certificate:
        """The certificate of a run whose refinement ended in these poses of the same scans."""
        joined = self.optimum.registered
        source, target = self.optimum.T_world_cam[joined], poses.T_world_cam[joined]
        if not len(joined):
            return self
        R = align_rotations(source[:, :3, :3], target[:, :3, :3])
        off = target[:, :3, 3] - source[:, :3, 3] @ R.T
        return replace(self, moved_m=float(np.median(np.linalg.norm(off - np.median(off, axis=0), axis=1))))
