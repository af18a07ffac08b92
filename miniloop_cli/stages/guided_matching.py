"""Stage: with known poses, failed pairs whose scans overlap are matched again.

The first matching compares a feature with all features of a scan, by the ratio test. With a relative pose, a feature is
searched in a small window only, so many more matches are found. Whether they agree on one rigid motion is then judged
as before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.config import Bundle, Estimation
from miniloop_cli.features.guided import guided_matches
from miniloop_cli.geometry import se3
from miniloop_cli.graph.visibility import partners
from miniloop_cli.ransac.cycle_edges import judge
from miniloop_cli.ransac.estimate import refit
from miniloop_cli.ransac.matches import edge_matches
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.poses import Poses
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.verdict import Verdict
from miniloop_cli.stages.artifacts import GUIDED
from miniloop_cli.stages.run import Run
from miniloop_cli.typing import Floats, Ints, Pair


def guided_matching(
    poses: Poses, edges: EdgeTable, scans: ScanSet, settings: Estimation, bundle: Bundle, min_matches: int, run: Run
) -> EdgeTable:
    """The edges, with failed ones replaced by those that are now verified; from the cache, or computed."""

    def make() -> dict[str, NDArray[Any]]:
        return EdgeTable.of(match_again(poses, edges, scans, settings, bundle, min_matches, run.workers)).arrays()

    inputs = (scans.key, poses, edges, settings, bundle, min_matches)
    found = EdgeTable.from_arrays(run.store.cached(GUIDED, inputs, make))
    return edges.replaced(found.edges()) if len(found) else edges


def match_again(
    poses: Poses,
    edges: EdgeTable,
    scans: ScanSet,
    settings: Estimation,
    bundle: Bundle,
    min_matches: int,
    workers: Workers,
) -> list[Edge]:
    """The newly verified edges.

    Pairs are matched again if they overlap by their poses and have no verified edge. Pairs of different components are
    not, although failed edges give a guess: if places look alike, a wrong guess finds matches that agree.
    """
    guesses = _guesses(poses, edges, scans, bundle.partners)
    found = guided_matches(
        list(guesses), np.array(list(guesses.values())).reshape(-1, 4, 4), scans.features, scans.feature_type,
        scans.camera, bundle, workers,
    )  # fmt: skip

    def solve(item: tuple[Pair, Ints]) -> Edge | None:
        pair, rows = item
        return _solved(pair, rows, guesses[pair], scans, settings, min_matches)

    work = list(zip(guesses, found, strict=True))
    solved = workers.map(solve, work, "solving again", len(work))
    return [edge for edge in solved if edge is not None and edge.verdict == Verdict.VERIFIED]


def _guesses(poses: Poses, edges: EdgeTable, scans: ScanSet, most: int) -> dict[Pair, Floats]:
    """Pairs to match again, each with its probable relative pose T_j_i (4, 4)."""
    T = poses.T_world_cam
    seen = partners(T, poses.registered, scans.points, scans.camera, most)
    verified = set(map(tuple, edges.pairs[edges.verified].tolist()))
    return {(i, j): se3.inverse(T[j]) @ T[i] for i, j in seen if (i, j) not in verified}


def _solved(
    pair: Pair, rows: Ints, T_j_i: Floats, scans: ScanSet, settings: Estimation, min_matches: int
) -> Edge | None:
    """The pair's edge from its guided matches with depth, starting at its probable pose; None if they are too few."""
    i, j = pair
    rows = rows[(rows[:, 0] < len(scans.points[i].points_m)) & (rows[:, 1] < len(scans.points[j].points_m))]
    if len(rows) < min_matches:
        return None
    matches = [edge_matches(scans.points, pair, rows)]
    result = refit(matches, T_j_i[None, :3].copy(), settings.ransac, settings.verification.chi2)
    if result is None:
        return None
    (found,) = result.edges
    edge = Edge(i, j, rows, found.inliers, found.T, found.information, found.covariance, solver="guided")
    return judge(edge, settings.verification)
