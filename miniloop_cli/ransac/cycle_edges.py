"""The edges of a cycle: their order for the solver, and their verdicts after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from miniloop_cli.config import Verification
from miniloop_cli.geometry import se3
from miniloop_cli.graph.edge_pool import Cycle
from miniloop_cli.ransac.estimate import EdgeEstimate
from miniloop_cli.ransac.matches import EdgeMatches, edge_matches
from miniloop_cli.scene.edge import Edge
from miniloop_cli.scene.points import Matches, ScanPoints
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.solvers import solver_name
from miniloop_cli.typing import Pair


def judge(edge: Edge, settings: Verification) -> Edge:
    """The edge with its verdict, from its inliers alone."""
    inliers, share = edge.inlier_count, edge.inlier_count / max(len(edge.matches), 1)
    if inliers >= settings.min_inliers and share >= settings.min_share:
        return replace(edge, verdict=Verdict.VERIFIED, rejection=Rejection.NONE)
    verdict = Verdict.WEAK if inliers >= settings.min_weak_inliers else Verdict.REJECTED
    return replace(edge, verdict=verdict, rejection=Rejection.FEW_INLIERS, detail=(inliers, len(edge.matches)))


def weakest_last(cycle: Cycle, matches: Matches) -> Cycle:
    """The cycle, rotated so that its weakest edge closes it: 3- and 4-cycles need only one match of that edge."""
    if len(cycle) == 2:
        return cycle
    ring = list(zip(cycle, cycle[1:] + cycle[:1], strict=True))
    weakest = min(range(len(cycle)), key=lambda k: (len(matches[in_order(ring[k])]), ring[k]))
    return cycle[weakest + 1 :] + cycle[: weakest + 1]


def sides(cycle: Cycle) -> list[Pair]:
    """Edges of a cycle as they are solved: along the chain, then the closing one from the first scan to the last."""
    return list(pairwise(cycle)) + ([(cycle[0], cycle[-1])] if len(cycle) > 2 else [])


def in_order(pair: Pair) -> Pair:
    """The pair, smaller number first."""
    return (min(pair), max(pair))


def directed(points: Sequence[ScanPoints], pair: Pair, matches: Matches) -> EdgeMatches:
    """Matches from scan pair[0] to scan pair[1], whichever of the two has the smaller number."""
    found = edge_matches(points, in_order(pair), matches[in_order(pair)])
    return found if pair[0] < pair[1] else found.reversed


def unsolved_edge(pair: Pair, matches: Matches, scans: int) -> Edge:
    """The rejected edge of a pair for which the solver of `scans` scans found no hypothesis."""
    i, j = in_order(pair)
    rows = matches[i, j]
    return Edge(i, j, rows, np.zeros(len(rows), bool), solver=solver_name(scans))


def judged_edge(
    pair: Pair,
    found: EdgeEstimate,
    matches: Matches,
    solver: str,
    hypotheses: int,
    settings: Verification,
    cycle: int = -1,
) -> Edge:
    """The estimate for a pair, in either direction, as an edge with its verdict."""
    T, information, covariance = found.T, found.information, found.covariance
    if pair[0] > pair[1]:
        # xi of the inverse pose is -Ad(T^-1) xi: information I_inv = Ad(T)^T I Ad(T).
        A = se3.adjoint(T)
        information, covariance = A.T @ information @ A, np.linalg.inv(A) @ covariance @ np.linalg.inv(A).T
        T = se3.inverse(T)
    i, j = in_order(pair)
    edge = Edge(i, j, matches[i, j], found.inliers, T, information, covariance, solver, cycle, hypotheses)
    return judge(edge, settings)
