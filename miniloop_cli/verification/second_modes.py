"""The best hypothesis about a pair that differs from the one that was chosen: the second mode of its matches.

Where a thing stands twice, or looks the same from two sides, the matches of a pair fall into two sets, each of which
agrees on a motion of its own. The estimator keeps the larger one; the other is found among the matches that are left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from miniloop_cli.config import Averaging, Estimation
from miniloop_cli.geometry import se3
from miniloop_cli.ransac.cycle_edges import judge
from miniloop_cli.ransac.estimate import estimate
from miniloop_cli.ransac.matches import edge_matches
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.verdict import Verdict
from miniloop_cli.typing import Floats

NEARLY = 0.5  # of the support of the best hypothesis: nearly as well


def second_modes(
    edges: EdgeTable,
    points: Sequence[ScanPoints],
    settings: Estimation,
    averaging: Averaging,
    seed: int,
    workers: Workers,
) -> EdgeTable:
    """Of each edge that has one, its second mode: another motion, with NEARLY as many inliers among the other matches.

    Each draws from its own generator, seeded by its scans.
    """
    left, inliers = edges.match_count - (edges.inlier_count - edges.followed), edges.inlier_count
    least = np.maximum(NEARLY * inliers, settings.verification.min_inliers)

    def second(row: int) -> Edge | None:
        edge = edges.edge(row)
        rest = edge.matches[~edge.inliers]
        rng = np.random.default_rng([seed, 2, edge.i, edge.j])
        matches = [edge_matches(points, edge.pair, rest)]
        found = estimate(matches, settings.ransac, settings.verification.chi2, rng)
        if found is None:
            return None
        (mode,) = found.edges
        other = replace(edge, matches=rest, inliers=mode.inliers, T_j_i=mode.T, information=mode.information)
        other = judge(replace(other, covariance=mode.covariance, solver="pairwise", followed=0), settings.verification)
        apart = differ(edge.T_j_i, other.T_j_i, averaging)
        return other if other.verdict == Verdict.VERIFIED and other.inlier_count >= least[row] and apart else None

    rows = np.flatnonzero((left >= least) & (inliers > 0)).tolist()
    return EdgeTable.of([mode for mode in workers.map(second, rows, "second modes", len(rows)) if mode is not None])


def differ(T_a: Floats, T_b: Floats, settings: Averaging) -> bool:
    """Whether two relative poses (4, 4) are farther apart than edges may be from poses."""
    angle_deg, distance_m = se3.angle_and_distance(se3.inverse(T_a) @ T_b)
    return bool(angle_deg > settings.max_residual_deg or distance_m > settings.max_residual_m)
