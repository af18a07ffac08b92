"""A pair of scans and what is known of their relative pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from miniloop_cli.typing import Bools, Floats, Ints

VERDICTS = VERIFIED, WEAK, REJECTED = "verified", "weak", "rejected"


@dataclass(frozen=True)
class Edge:
    """A pair of scans and what is known of their relative pose.

    `T_j_i` (4, 4) maps points of scan i into scan j; `matches` (m, 2) feature rows, `inliers` (m,) bool;
    `information` and `covariance` (6, 6) as in EdgeEstimate; `cycle`: number of the cycle that was solved, -1 for a
    pair; `verdict`: verified, weak (few inliers: used only by scans that need it) or rejected, with the `reason`;
    `confirmed`: something beside the images speaks for it, so that it may stand without a loop of edges.
    """

    i: int
    j: int
    matches: Ints
    inliers: Bools
    T_j_i: Floats = field(default_factory=lambda: np.eye(4))
    information: Floats = field(default_factory=lambda: np.zeros((6, 6)))
    covariance: Floats = field(default_factory=lambda: np.full((6, 6), np.inf))
    solver: str = "pairwise"
    cycle: int = -1
    hypotheses: int = 0
    verdict: str = REJECTED
    reason: str = ""
    confirmed: bool = False

    @property
    def inlier_count(self) -> int:
        return int(self.inliers.sum())


def pairs_of(edges: Sequence[Edge]) -> Ints:
    """(m, 2) scans i and j of each edge."""
    return np.array([(edge.i, edge.j) for edge in edges], np.int64).reshape(-1, 2)
