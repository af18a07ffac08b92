"""What is known of the scans beside their matches, to be asked about relative poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.graph.visibility import partners
from miniloop_cli.runtime.artifact_store import Arrays, Store, content_fingerprint, fingerprint
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.thumbnail import View
from miniloop_cli.typing import Bools, Floats, Ints, Pair
from miniloop_cli.verification.photometric import compare_views

COMPARED_PARTNERS = 5  # scans that each scan of a result is compared with
PRIOR_CELLS = 10  # cells that are taken to look alike before any is seen: without cells nothing is said


@dataclass(frozen=True)
class PhotometricCheck:
    """Pictures of the scans, their points and camera.

    `outline`: which features of each scan lie on outlines; `step_m` (n,): repetition of each (m), 0 if there is none.
    Scans that could not be read have no view. Answers are kept in a `store` under the `key` that names the scans.
    """

    views: Sequence[View | None]
    points: Sequence[ScanPoints]
    outline: Sequence[Bools]
    step_m: Sequence[float]
    camera: Camera
    store: Store | None = None
    key: str = ""
    _said: dict[tuple[Pair, bytes], tuple[int, int]] = field(default_factory=dict, repr=False)  # asked before

    def votes(self, pairs: Sequence[Pair], T_j_i: Floats) -> Ints:
        """(m, 2) cells that speak for and against relative poses (m, 4, 4) of pairs (i, j)."""
        questions = [(pair, T.tobytes()) for pair, T in zip(pairs, T_j_i, strict=True)]
        new = [k for k, question in enumerate(questions) if question not in self._said]
        seen = [k for k in new if all(self.views[scan] is not None for scan in pairs[k])]
        self._said.update(dict.fromkeys((questions[k] for k in new), (0, 0)))
        answers = self._answers(np.array([pairs[k] for k in seen]).reshape(-1, 2), T_j_i[seen])
        self._said.update(zip((questions[k] for k in seen), map(tuple, answers), strict=True))
        return np.array([self._said[question] for question in questions], np.int64).reshape(-1, 2)

    def _answers(self, pairs: Ints, T_j_i: Floats) -> list[list[int]]:
        """For and against, of pairs (m, 2) of scans that have views."""

        def said() -> Arrays:
            views = ((self.views[i], self.views[j]) for i, j in pairs)
            return {"said": np.array(compare_views(views, T_j_i, self.camera), np.int64).reshape(-1, 2)}

        key = fingerprint("alike", self.key, content_fingerprint([pairs, T_j_i]))
        kept = self.store.kept("alike", key, said) if self.store and len(pairs) else said()
        return kept["said"].tolist()

    def neighbours(self, T_world_cam: Floats, scans: Ints) -> tuple[list[Pair], Floats]:
        """Pairs of `scans` that by their poses see the same place, and these relative poses (m, 4, 4)."""
        pairs = partners(T_world_cam, scans, self.points, self.camera, COMPARED_PARTNERS)
        i, j = np.array(pairs, np.int64).reshape(-1, 2).T
        return pairs, se3.inverse(T_world_cam[j]) @ T_world_cam[i]


def agreement_ratio(said: Ints) -> Floats:
    """(..., 2) cells for and against to the share (...) that is for, PRIOR_CELLS among them; 1 where there are none."""
    return (said[..., 0] + PRIOR_CELLS) / (said.sum(axis=-1) + PRIOR_CELLS)
