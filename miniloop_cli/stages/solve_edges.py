"""Stage: from matches to judged relative poses, by solving cycles of the overlap graph, then shorter ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count

import numpy as np

from miniloop_cli.config import Estimation, Verification
from miniloop_cli.graph.cycles import decompose
from miniloop_cli.graph.edge_pool import Cycle
from miniloop_cli.graph.overlap import overlap_graph
from miniloop_cli.ransac.cycle_edges import directed, judged_edge, sides, unsolved_edge, weakest_last
from miniloop_cli.ransac.distance_consistency import consistent
from miniloop_cli.ransac.estimate import estimate
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.edge import Edge, EdgeTable
from miniloop_cli.scene.points import Matches, ScanPoints
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.scene.verdict import Rejection, Verdict
from miniloop_cli.solvers import solver_name
from miniloop_cli.stages.artifacts import EDGES
from miniloop_cli.stages.match import match_arrays
from miniloop_cli.stages.run import Run
from miniloop_cli.typing import Pair
from miniloop_cli.verification.loop_support import Prediction, agree, pose_graph, predict

MAX_CHECKED_MATCHES = 150  # a pair with more is rarely false, and its distances are not checked


def solve_edges(matches: Matches, scans: ScanSet, settings: Estimation, run: Run) -> EdgeTable:
    """Every edge of the overlap graph, solved in cycles and judged; from the cache, or computed."""

    def make() -> dict[str, np.ndarray]:
        return solve_cycles(matches, scans.points, settings, run.seed, run.workers).arrays()

    inputs = (scans.key, match_arrays(matches), settings, run.seed)
    return EdgeTable.from_arrays(run.store.cached(EDGES, inputs, make))


def solve_cycles(
    matches: Matches, points: Sequence[ScanPoints], settings: Estimation, seed: int, workers: Workers
) -> EdgeTable:
    """Every edge of the overlap graph, judged.

    The graph is decomposed into cycles of at most `cycles.longest` scans, and each is solved jointly. Edges that are
    not verified are solved again in a loop over two verified edges. Those without loops that agree are decomposed again
    into shorter cycles, and finally solved alone. Edges whose distances allow too few inliers would spoil the cycles of
    others, so they are only solved in loops over verified edges. Each cycle has its own generator, seeded by its scans,
    so the result does not depend on the order of work.
    """
    solved: dict[Pair, Edge] = {}
    room = _room(matches, points, settings, workers)
    few, enough = settings.verification.min_weak_inliers, settings.verification.min_inliers
    for pair in (pair for pair in matches if room[pair] < few):
        edge = unsolved_edge(pair, matches, 2)
        solved[pair] = replace(edge, rejection=Rejection.INCONSISTENT_DISTANCES, detail=(few, 0.0))
    numbers = count()

    def solve(cycles: Sequence[Cycle], what: str) -> Iterator[list[Edge]]:
        work = [(next(numbers), cycle) for cycle in cycles]
        return workers.spread(_solve_cycle, (matches, points, settings, seed), work, what, len(work))

    def keep(edge: Edge) -> None:
        before = solved.get(edge.pair)
        if before is None or edge.verdict == Verdict.VERIFIED or edge.inlier_count > before.inlier_count:
            solved[edge.pair] = edge

    left = [pair for pair in matches if room[pair] >= enough]
    waiting = [pair for pair in matches if few <= room[pair] < enough]
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
                edge = next(edge for edge in edges if edge.pair == pair)
                keep(promote_by_loops(edge, found, settings.verification))
            # Edges that loops over verified edges do not confirm would pass shorter cycles and pairs by chance only.
            done |= _verified(solved) | {pair for pair, found in loops.items() if found.credible}
        left, waiting = ([pair for pair in pairs if pair not in done] for pairs in (left, waiting))
    return EdgeTable.of(list(solved.values()))


def promote_by_loops(edge: Edge, loops: Prediction, settings: Verification) -> Edge:
    """The edge, a weak one verified if loops over verified edges agree with each other and with its pose."""
    share = edge.inlier_count / max(len(edge.matches), 1)
    weak = edge.verdict == Verdict.WEAK and share >= settings.min_share
    if not weak or not loops.credible or not agree(loops.T_j_i, edge.T_j_i):
        return edge
    return replace(edge, verdict=Verdict.VERIFIED, rejection=Rejection.NONE, loops=loops.agree + 1)


def _verified(solved: Mapping[Pair, Edge]) -> set[Pair]:
    return {pair for pair, edge in solved.items() if edge.verdict == Verdict.VERIFIED}


def _verified_loops(pairs: Sequence[Pair], solved: Mapping[Pair, Edge]) -> dict[Pair, Prediction]:
    """The loop over two verified edges in which each pair is solved again, for pairs that have one."""
    verified = (edge for edge in solved.values() if edge.verdict == Verdict.VERIFIED)
    graph = pose_graph((edge.i, edge.j, edge.T_j_i, edge.inlier_count) for edge in verified)
    return {pair: found for pair in pairs if (found := predict(graph, pair))}


def _room(matches: Matches, points: Sequence[ScanPoints], settings: Estimation, workers: Workers) -> dict[Pair, float]:
    """Upper bounds of the inliers of each pair, by sets of matches with consistent distances.

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
    shared: tuple[Matches, Sequence[ScanPoints], Estimation, int], numbered: tuple[int, Cycle]
) -> list[Edge]:
    (matches, points, settings, seed), (number, cycle) = shared, numbered
    cycle = weakest_last(cycle, matches)
    chain = sides(cycle)
    inputs = [directed(points, pair, matches) for pair in chain]
    rng = np.random.default_rng([seed, len(cycle), *cycle])
    result = estimate(inputs, settings.ransac, settings.verification.chi2, rng)
    if result is None:
        return [unsolved_edge(pair, matches, len(cycle)) for pair in chain]
    solver, cycle_number = solver_name(len(cycle)), number if len(cycle) > 2 else -1
    return [
        judged_edge(pair, found, matches, solver, result.hypotheses, settings.verification, cycle_number)
        for pair, found in zip(chain, result.edges, strict=True)
    ]
