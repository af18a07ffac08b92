"""Stage: edges between the keyframes of a recording and those of earlier ones."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace

import numpy as np

from miniloop_cli.config import Settings
from miniloop_cli.features.retrieval import around
from miniloop_cli.mapping.retrieval import most_similar
from miniloop_cli.scene.edge import EdgeTable
from miniloop_cli.scene.points import Matches
from miniloop_cli.scene.scene_map import MapPart, first_keyframes
from miniloop_cli.stages.candidates import comparer
from miniloop_cli.stages.keyframes import common_scans
from miniloop_cli.stages.run import Run
from miniloop_cli.stages.solve_edges import solve_edges
from miniloop_cli.typing import Floats32, Ints, Pair

MOST_COMPARED = 10  # keyframes of earlier recordings that each is compared with; as many again around matches
REACH = 2  # keyframes around both ends of a pair that matches, which are compared as well


def solve_between(parts: Sequence[MapPart], vectors: Floats32, settings: Settings, run: Run) -> dict[Pair, EdgeTable]:
    """Edges between the keyframes of the last recording and those of each earlier one, solved and judged.

    vectors (K, d) retrieve similar keyframes. Each keyframe of the last recording is compared with the most similar
    ones of all others, then with those around pairs that match. Edges that are not rejected are kept, with their
    inliers only; by the numbers of the recordings, with keyframes numbered within the two.
    """
    first = first_keyframes(parts)
    last, n, count = len(parts) - 1, int(first[-2]), int(first[-1])
    alike = {(int(i), j) for j in range(n, count) for i in most_similar(vectors[:n], vectors[j], MOST_COMPARED)}
    ends = np.unique([i for i, _ in alike])
    chosen = np.unique(np.clip(ends[:, None] + np.arange(-REACH, REACH + 1), 0, n - 1))
    chosen = np.concatenate([chosen, np.arange(n, count)])
    scans, m = common_scans(parts, chosen), len(chosen) - (count - n)

    compare = comparer(scans, settings.matching, run.workers)
    pairs = [(int(np.searchsorted(chosen, i)), j - n + m) for i, j in sorted(alike)]
    matches = compare(pairs)
    matches |= compare(_around(matches, set(pairs), m, len(scans)))
    # Every edge joins the last recording to another one, so cycles have even lengths, and odd ones are not searched.
    even = settings.cycles.model_copy(update={"longest": settings.cycles.longest // 2 * 2})
    edges = solve_edges(matches, scans, settings.estimation._replace(cycles=even), run)
    edges = edges.subset(edges.open).inliers_only().rounded()
    return {(a, last): _of_pair(edges, chosen, first, a) for a in range(last)}


def _around(matches: Matches, known: Set[Pair], m: int, count: int) -> list[Pair]:
    """Pairs of scans (i, j), i < m <= j, next to those that match, sorted: at most MOST_COMPARED of each j on average.

    Those next to the most matches come first: if everything shows one place, a part of all pairs suffices.
    """
    best = dict[Pair, int]()
    for pair, rows in matches.items():
        for near in around([pair], count, REACH):
            if near[0] < m <= near[1] and near not in known:
                best[near] = max(best.get(near, 0), len(rows))
    order = sorted(best, key=lambda pair: (-best[pair], pair))
    return sorted(order[: MOST_COMPARED * (count - m)])


def _of_pair(edges: EdgeTable, chosen: Ints, first: Ints, a: int) -> EdgeTable:
    """The edges between recording a and the last one, numbered within the two; edges' ends are rows of `chosen`."""
    i, j = chosen[edges.i], chosen[edges.j]
    own = (i >= first[a]) & (i < first[a + 1])
    found = edges.subset(own)
    return replace(found, i=i[own] - first[a], j=j[own] - first[-2] + first[a + 1] - first[a])
