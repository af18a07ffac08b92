"""The second round: with poses known, pairs that failed are matched again where their scans must overlap.

The first round has to tell a match from all features of a scan, by the ratio test. With a relative pose at hand a
feature is looked for in a small window only, so that many more are found; whether they agree on one rigid motion is
then judged as in the first round.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.config import Settings
from miniloop_cli.features.guided import guided_matches
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.graph.visibility import partners
from miniloop_cli.ransac.cycle_edges import judge
from miniloop_cli.ransac.estimate import refit
from miniloop_cli.ransac.matches import edge_matches
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import VERIFIED, Edge
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.scene.points import ScanPoints
from miniloop_cli.scene.poses import Poses
from miniloop_cli.typing import Floats, Ints, Pair


def match_guided(
    edges: Sequence[Edge],
    poses: Poses,
    features: Sequence[ScanFeatures],
    points: Sequence[ScanPoints],
    camera: Camera,
    settings: Settings,
    workers: Workers,
) -> list[Edge]:
    """The edges that a second look verified.

    Looked at again are pairs that by their poses see the same place and have no verified edge. Pairs that no poses
    join are not, though failed edges have guesses for them: where places look alike, a wrong guess finds matches that
    agree.
    """
    known = {(edge.i, edge.j): edge for edge in edges}
    guesses = _guesses(known, poses, points, camera, settings.bundle.partners)
    found = guided_matches(
        list(guesses), np.array(list(guesses.values())).reshape(-1, 4, 4), features, camera,
        settings.bundle.radius_px, settings, workers,
    )  # fmt: skip

    def solve(item: tuple[Pair, Ints]) -> Edge | None:
        pair, rows = item
        return _solved(pair, rows, guesses[pair], points, settings)

    work = list(zip(guesses, found, strict=True))
    solved = workers.map(solve, work, "solving again", len(work))
    return [edge for edge in solved if edge is not None and edge.verdict == VERIFIED]


def replace_edges(edges: Sequence[Edge], found: Sequence[Edge]) -> list[Edge]:
    """The edges and those found, these in place of others of the same pairs; sorted by (i, j)."""
    by_pair = {(edge.i, edge.j): edge for edge in (*edges, *found)}
    return [by_pair[pair] for pair in sorted(by_pair)]


def _guesses(
    known: dict[Pair, Edge], poses: Poses, points: Sequence[ScanPoints], camera: Camera, most: int
) -> dict[Pair, Floats]:
    """Pairs to look at again, each with its probable relative pose T_j_i (4, 4)."""
    T = poses.T_world_cam
    seen = partners(T, poses.registered, points, camera, most)
    failed = [pair for pair in seen if pair not in known or known[pair].verdict != VERIFIED]
    return {(i, j): se3.inverse(T[j]) @ T[i] for i, j in failed}


def _solved(pair: Pair, rows: Ints, T_j_i: Floats, points: Sequence[ScanPoints], settings: Settings) -> Edge | None:
    """The pair's edge by its guided matches with depth, begun from its probable pose; None if they are too few."""
    i, j = pair
    rows = rows[(rows[:, 0] < len(points[i].points_m)) & (rows[:, 1] < len(points[j].points_m))]
    if len(rows) < settings.matching.min_matches:
        return None
    result = refit(
        [edge_matches(points, pair, rows)], T_j_i[None, :3].copy(), settings.ransac, settings.verification.chi2
    )
    if result is None:
        return None
    (found,) = result.edges
    edge = Edge(i, j, rows, found.inliers, found.T, found.information, found.covariance, solver="guided")
    return judge(edge, settings.verification)
