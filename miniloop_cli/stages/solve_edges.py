"""From matches to verified relative poses: solve the cycles of the graph, then shorter ones, and judge every edge."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count

import numpy as np

from miniloop_cli.config import Settings, Verification
from miniloop_cli.graph.cycles import decompose
from miniloop_cli.graph.edge_pool import Cycle
from miniloop_cli.graph.overlap import overlap_graph
from miniloop_cli.ransac.cycle_edges import _unsolved, directed, judged_edge, sides, weakest_last
from miniloop_cli.ransac.distance_consistency import consistent
from miniloop_cli.ransac.estimate import estimate
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import VERIFIED, WEAK, Edge
from miniloop_cli.scene.points import Matches, ScanPoints
from miniloop_cli.solvers import solver_name
from miniloop_cli.typing import Pair
from miniloop_cli.verification.loop_support import Prediction, agree, pose_graph, predict

MAX_CHECKED_MATCHES = 150  # matches beyond which a pair is not checked for distances: it is hardly ever false


def promote_by_loops(edge: Edge, loops: Prediction, settings: Verification) -> Edge:
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
    least = settings.verification.min_weak_inliers
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
        if settings.cycles.loop_support and longest == settings.cycles.longest > 2:
            loops = _verified_loops([pair for pair in left + waiting if pair not in done], solved)
            closed = solve([found.cycle for found in loops.values()], "closing loops")
            for (pair, found), edges in zip(loops.items(), closed, strict=True):
                keep(
                    next(
                        promote_by_loops(edge, found, settings.verification)
                        for edge in edges
                        if (edge.i, edge.j) == pair
                    )
                )
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

    One of 0 (no `min_weak_inliers`, as most pairs that do not overlap), `min_weak_inliers`, and infinity
    (`min_inliers` or more).
    """
    if settings.ransac.score == "count":
        return dict.fromkeys(matches, np.inf)
    few, enough = settings.verification.min_weak_inliers, settings.verification.min_inliers

    def room(pair: Pair) -> float:
        rows = matches[pair]
        if len(rows) > MAX_CHECKED_MATCHES:
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
    solver, cycle_number = solver_name(len(cycle)), number if len(cycle) > 2 else -1
    return [
        judged_edge(pair, found, matches, solver, result.hypotheses, settings.verification, cycle_number)
        for pair, found in zip(chain, result.edges, strict=True)
    ]
