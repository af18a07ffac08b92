"""From matches to verified relative poses: solve the cycles of the graph, then shorter ones, and judge every edge."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count, pairwise

import numpy as np

from miniloop_cli.config import Settings, Verification
from miniloop_cli.geometry import se3
from miniloop_cli.graph.cycles import Cycle, decompose
from miniloop_cli.graph.overlap import Matches, ScanPoints, consistent, edge_matches, overlap_graph
from miniloop_cli.graph.rescue import Prediction, agree, pose_graph, predict
from miniloop_cli.parallel import Workers
from miniloop_cli.ransac.estimate import EdgeEstimate, EdgeMatches, estimate
from miniloop_cli.ransac.search import SOLVERS
from miniloop_cli.typing import Bools, Floats, Ints, Pair

VERDICTS = VERIFIED, WEAK, REJECTED = "verified", "weak", "rejected"
MANY = 150  # matches beyond which a pair is not checked for distances: it is hardly ever false


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


def judge(edge: Edge, settings: Verification) -> Edge:
    """The edge with its verdict, from its inliers alone."""
    inliers, share = edge.inlier_count, edge.inlier_count / max(len(edge.matches), 1)
    if inliers >= settings.min_inliers and share >= settings.min_share:
        return replace(edge, verdict=VERIFIED, reason="")
    reason = f"{inliers} inliers of {len(edge.matches)} matches"
    return replace(edge, verdict=WEAK if inliers >= settings.rescue_inliers else REJECTED, reason=reason)


def vouched(edge: Edge, loops: Prediction, settings: Verification) -> Edge:
    """The edge, a weak one verified if loops over verified edges agree with each other and with its pose."""
    share = edge.inlier_count / max(len(edge.matches), 1)
    if edge.verdict != WEAK or share < settings.min_share or not loops.credible or not agree(loops.T_j_i, edge.T_j_i):
        return edge
    return replace(edge, verdict=VERIFIED, reason=f"{edge.reason}; {loops.agree + 1} loops over verified edges agree")


def solve_edges(
    matches: Matches, points: Sequence[ScanPoints], settings: Settings, seed: int, workers: Workers
) -> list[Edge]:
    """Every edge of the overlap graph, judged, sorted by (i, j).

    The graph is decomposed into cycles of at most `cycles.longest` scans and each is solved jointly. Edges that are
    not verified there are tried again in a loop over two verified edges; those without loops that agree are decomposed
    again into shorter cycles, and in the end solved alone. Edges whose distances leave no room for enough inliers would
    only spoil the cycles of others: they wait for loops over verified edges. Each cycle draws from its own generator,
    seeded by its scans: the result does not depend on the order of work.
    """
    solved: dict[Pair, Edge] = {}
    room = _room(matches, points, settings, workers)
    least = settings.verification.rescue_inliers
    for pair in (pair for pair in matches if room[pair] < least):
        solved[pair] = replace(_unsolved(pair, matches, 2), reason=f"no {least} matches agree in their distances")
    numbers = count()

    def solve(cycles: Sequence[Cycle], what: str) -> Iterator[list[Edge]]:
        work = [(next(numbers), cycle) for cycle in cycles]
        return workers.spread(_solve_cycle, (matches, points, settings, seed), work, what, len(work))

    def keep(edge: Edge) -> None:
        before = solved.get((edge.i, edge.j))
        if before is None or edge.verdict == VERIFIED or edge.inlier_count > before.inlier_count:
            solved[edge.i, edge.j] = edge

    possible = [pair for pair in matches if room[pair] >= least]
    left = [pair for pair in possible if room[pair] >= settings.verification.min_inliers]
    waiting = [pair for pair in possible if room[pair] < settings.verification.min_inliers]
    for longest in range(settings.cycles.longest, 1, -1):
        taking_part = left + waiting if longest == 2 else left
        graph = overlap_graph(len(points), {pair: matches[pair] for pair in taking_part})
        cycles = decompose(graph, longest, settings.cycles.decomposition)
        for edges in solve(cycles, f"solving {longest}-cycles" if longest > 2 else "solving pairs"):
            for edge in edges:
                keep(edge)
        done = {cycle for cycle in cycles if len(cycle) == 2} | _verified(solved)
        if settings.cycles.rescue and longest == settings.cycles.longest > 2:
            loops = _verified_loops([pair for pair in left + waiting if pair not in done], solved)
            closed = solve([found.cycle for found in loops.values()], "closing loops")
            for (pair, found), edges in zip(loops.items(), closed, strict=True):
                keep(next(vouched(edge, found, settings.verification) for edge in edges if (edge.i, edge.j) == pair))
            # What loops over verified edges do not confirm, shorter cycles and pairs would only find by chance.
            done |= _verified(solved) | {pair for pair, found in loops.items() if found.credible}
        left, waiting = ([pair for pair in pairs if pair not in done] for pairs in (left, waiting))
    return [solved[pair] for pair in sorted(solved)]


def _verified(solved: Mapping[Pair, Edge]) -> set[Pair]:
    return {pair for pair, edge in solved.items() if edge.verdict == VERIFIED}


def _verified_loops(pairs: Sequence[Pair], solved: Mapping[Pair, Edge]) -> dict[Pair, Prediction]:
    """Of the pairs that have one, the loop over two verified edges through which they are tried again."""
    graph = pose_graph((e.i, e.j, e.T_j_i, e.inlier_count) for e in solved.values() if e.verdict == VERIFIED)
    return {pair: found for pair in pairs if (found := predict(graph, pair))}


def _room(matches: Matches, points: Sequence[ScanPoints], settings: Settings, workers: Workers) -> dict[Pair, float]:
    """How many inliers each pair can have at all: bounds by sets of matches that agree in their distances.

    One of 0 (no `rescue_inliers`, as most pairs that do not overlap), `rescue_inliers`, and infinity (`min_inliers` or
    more).
    """
    if settings.ransac.score == "count":
        return dict.fromkeys(matches, np.inf)
    few, enough = settings.verification.rescue_inliers, settings.verification.min_inliers

    def room(pair: Pair) -> float:
        rows = matches[pair]
        if len(rows) > MANY:
            return np.inf
        threshold_m = settings.ransac.threshold_m
        for least, bound in ((enough, np.inf), (few, few)):
            if consistent(points, pair, rows, threshold_m, least - 1).any():
                return bound
        return 0

    return dict(zip(matches, workers.map(room, list(matches), "checking distances", len(matches)), strict=True))


def _solve_cycle(
    shared: tuple[Matches, Sequence[ScanPoints], Settings, int], numbered: tuple[int, Cycle]
) -> list[Edge]:
    (matches, points, settings, seed), (number, cycle) = shared, numbered
    cycle = weakest_last(cycle, matches)
    chain = sides(cycle)
    inputs = [directed(points, pair, matches) for pair in chain]
    rng = np.random.default_rng([seed, len(cycle), *cycle])
    result = estimate(inputs, settings.ransac, settings.verification.chi2, rng)
    if result is None:
        return [_unsolved(pair, matches, len(cycle)) for pair in chain]
    solver, cycle_number = SOLVERS[len(cycle)].name, number if len(cycle) > 2 else -1
    return [
        judged_edge(pair, found, matches, solver, result.hypotheses, settings.verification, cycle_number)
        for pair, found in zip(chain, result.edges, strict=True)
    ]


def weakest_last(cycle: Cycle, matches: Matches) -> Cycle:
    """The same cycle, begun so that its weakest edge closes it: there a 3- or 4-cycle asks for one match only."""
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


def _unsolved(pair: Pair, matches: Matches, scans: int) -> Edge:
    i, j = in_order(pair)
    rows, reason = matches[i, j], "no hypothesis fits the matches"
    return Edge(i, j, rows, np.zeros(len(rows), bool), solver=SOLVERS[scans].name, reason=reason)


def judged_edge(
    pair: Pair,
    found: EdgeEstimate,
    matches: Matches,
    solver: str,
    hypotheses: int,
    settings: Verification,
    cycle: int = -1,
) -> Edge:
    """What was found for a pair, in either direction, as an edge with its verdict."""
    T, information, covariance = found.T, found.information, found.covariance
    if pair[0] > pair[1]:
        # xi of the inverse pose is -Ad(T^-1) xi: information I_inv = Ad(T)^T I Ad(T).
        A = se3.adjoint(T)
        information, covariance = A.T @ information @ A, np.linalg.inv(A) @ covariance @ np.linalg.inv(A).T
        T = se3.inverse(T)
    i, j = in_order(pair)
    edge = Edge(i, j, matches[i, j], found.inliers, T, information, covariance, solver, cycle, hypotheses)
    return judge(edge, settings)
