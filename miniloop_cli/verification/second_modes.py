"""The second mode of the matches of a pair: the best hypothesis that differs from the chosen one.

If an object is present twice, or looks the same from two sides, the matches of a pair form two sets with different
motions. The estimator keeps the larger set; the other is found among the remaining matches.
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

NEARLY = 0.5  # of the support of the best hypothesis


def second_modes(
    edges: EdgeTable,
    points: Sequence[ScanPoints],
    settings: Estimation,
    averaging: Averaging,
    seed: int,
    workers: Workers,
) -> EdgeTable:
    """The second modes of edges: another motion with at least NEARLY times as many inliers, among the other matches.

    Each edge has its own generator, seeded by its scans.
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
    """Whether two relative poses T_a, T_b (4, 4) differ by more than the largest residual of an edge."""
    angle_deg, distance_m = se3.angle_and_distance(se3.inverse(T_a) @ T_b)
    return bool(angle_deg > settings.max_residual_deg or distance_m > settings.max_residual_m)
