"""The photometric check: votes of the cells of two scans for and against a relative pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.graph.visibility import partners
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.typing import Bools, Floats, Ints
from miniloop_cli.verification.photometric import compare_views

COMPARED_PARTNERS = 5  # scans that each scan of a result is compared with
PRIOR_CELLS = 10  # cells that count as agreeing in advance, so that few cells do not decide


@dataclass(frozen=True)
class PhotometricCheck:
    """Views and properties of n scans that are independent of their matches.

    `views`: small images with depth, None for unreadable scans; `outline`: which features of each scan lie at depth
    jumps; `step_m` (n,): period of the pattern of scans that show one, else 0.
    """

    views: Sequence[View | None]
    points: Sequence[ScanPoints]
    outline: Sequence[Bools]
    step_m: Sequence[float] | Floats
    camera: Camera
    _known: dict[bytes, tuple[int, int]] = field(default_factory=dict, repr=False)  # earlier results

    def votes(self, pairs: Ints, T_j_i: Floats) -> Ints:
        """(m, 2) cells that agree and that disagree with relative poses (m, 4, 4) of pairs (m, 2); 0 without views."""
        questions = [pair.tobytes() + T.tobytes() for pair, T in zip(pairs, T_j_i, strict=True)]
        new = [
            k
            for k, question in enumerate(questions)
            if question not in self._known and all(self.views[scan] is not None for scan in pairs[k])
        ]
        compared = compare_views(((self.views[i], self.views[j]) for i, j in pairs[new]), T_j_i[new], self.camera)
        self._known.update(zip((questions[k] for k in new), compared, strict=True))
        return np.array([self._known.get(question, (0, 0)) for question in questions], np.int64).reshape(-1, 2)

    def neighbours(self, T_world_cam: Floats, scans: Ints, group: Ints | None = None) -> tuple[Ints, Floats]:
        """Pairs (m, 2) of `scans` that by their poses see the same place, and these relative poses (m, 4, 4).

        `group` (n,) of each scan: only pairs across groups.
        """
        seen = partners(T_world_cam, scans, self.points, self.camera, COMPARED_PARTNERS, group)
        pairs = np.array(seen, np.int64)
        i, j = pairs.reshape(-1, 2).T
        return pairs.reshape(-1, 2), se3.inverse(T_world_cam[j]) @ T_world_cam[i]


def agreement_ratio(votes: Ints) -> Floats:
    """Share (...) of agreeing cells, from numbers (..., 2) that agree and disagree; PRIOR_CELLS more agree."""
    return (votes[..., 0] + PRIOR_CELLS) / (votes.sum(axis=-1) + PRIOR_CELLS)
