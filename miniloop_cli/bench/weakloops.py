"""Edges with few matches, solved alone and in cycles: the share of right edges.

Weak edges are real, or thinned: random subsets of the matches of strong pairs. Each is solved as a pair and as the
weakest edge of one cycle of every length, with the same matches, the same fixed number of hypotheses and the same final
refinement. The other edges of a cycle are strong, or as weak as the edge itself.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import networkx as nx
import numpy as np
from matplotlib.figure import Figure

from miniloop_cli.bench import Row
from miniloop_cli.bench.known_overlaps import Overlaps, read_overlaps, right
from miniloop_cli.config import Ransac
from miniloop_cli.geometry import se3
from miniloop_cli.graph.edge_pool import Cycle
from miniloop_cli.graph.overlap import overlap_graph
from miniloop_cli.presets import load_settings
from miniloop_cli.ransac.cycle_edges import directed, in_order, sides, weakest_last
from miniloop_cli.ransac.estimate import estimate
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.points import Matches
from miniloop_cli.solvers import solver_name
from miniloop_cli.typing import Ints, Pair

BINS = ((8, 11), (12, 15), (16, 20), (21, 25))  # matches of a weak edge
MIN_MATCHES, MAX_MATCHES = BINS[0][0], BINS[-1][1]
DRAWN = 10  # smallest number of edges for a point of the figure
STRONG = 40  # matches from which an edge can be a strong partner
LEAST_TRUE = 5  # true matches; with fewer, no estimator is expected to find the pose
LENGTHS = (3, 4, 5, 6, 7)
KINDS, PARTNERS = ("thinned", "real"), ("strong", "weak")


@dataclass(frozen=True)
class Loop:
    """A weak edge, and one cycle of each length through it; `matches` of all their edges."""

    pair: Pair
    cycles: dict[int, Cycle]
    matches: Matches


def draw_loops(overlaps: Overlaps, kind: str, partners: str, most: int, rng: np.random.Generator) -> list[Loop]:
    """At most `most` weak edges that lie on cycles of all LENGTHS, and these cycles, at random."""
    strong = {pair: rows for pair, rows in overlaps.matches.items() if len(rows) >= STRONG}
    if kind == "thinned":
        weak = {pair: _some(rows, rng) for pair, rows in strong.items()}
    else:
        weak = {pair: rows for pair, rows in overlaps.matches.items() if len(rows) <= MAX_MATCHES}
    known = overlaps.known
    weak = {
        (i, j): rows
        for (i, j), rows in weak.items()
        if known[i] and known[j] and overlaps.true_matches((i, j), rows) >= LEAST_TRUE
    }
    others = strong if partners == "strong" else weak
    graph, loops = overlap_graph(len(overlaps.points), others), list[Loop]()
    targets = list(weak)
    for k in rng.permutation(len(targets)):
        if len(loops) == most:
            break
        cycles = {n: random_cycle(graph, targets[k], n, rng) for n in LENGTHS}
        if all(cycles.values()):
            loops.append(Loop(targets[k], cycles, {**others, targets[k]: weak[targets[k]]}))
    return loops


def _some(rows: Ints, rng: np.random.Generator) -> Ints:
    """MIN_MATCHES to MAX_MATCHES of the matches, in their order."""
    return rows[np.sort(rng.permutation(len(rows))[: rng.integers(MIN_MATCHES, MAX_MATCHES + 1)])]


def random_cycle(graph: nx.Graph, pair: Pair, length: int, rng: np.random.Generator) -> Cycle:
    """A cycle of `length` scans over the edge `pair` and edges of the graph; empty if there is none."""
    left = nx.restricted_view(graph, [], [pair] if graph.has_edge(*pair) else [])
    steps = nx.single_source_shortest_path_length(left, pair[1], cutoff=length - 1)

    def extended(path: Cycle) -> Cycle:
        if len(path) == length:
            return path if path[-1] == pair[1] else ()
        ahead = length - len(path) - 1
        near = [
            k
            for k in left[path[-1]]
            if k not in path and steps.get(k, length) <= ahead and (k != pair[1]) == (ahead > 0)
        ]
        for k in rng.permutation(len(near)):
            if found := extended((*path, near[k])):
                return found
        return ()

    return extended((pair[0],))


def solve_loop(
    loop: Loop, overlaps: Overlaps, hypotheses: int, seed: int
) -> dict[str, tuple[bool, float, float, float]]:
    """By solver: whether the edge is right, its errors (degrees, metres; infinite without an estimate), CPU seconds."""
    settings, chi2 = Ransac(iterations=hypotheses, adaptive=False), load_settings().verification.chi2
    results = {}
    for scans, cycle in ({2: loop.pair} | loop.cycles).items():
        edges = sides(weakest_last(cycle, loop.matches))
        inputs = [directed(overlaps.points, edge, loop.matches) for edge in edges]
        begin = time.thread_time()
        found = estimate(inputs, settings, chi2, np.random.default_rng([seed, scans, *loop.pair]))
        seconds = time.thread_time() - begin
        outcome = (False, np.inf, np.inf)
        if found is not None:
            (k,) = (k for k, edge in enumerate(edges) if in_order(edge) == loop.pair)
            T = found.edges[k].T
            deg, metres = overlaps.errors([loop.pair], T if edges[k] == loop.pair else se3.inverse(T))
            outcome = (bool(right(deg, metres)[0]), float(deg[0]), float(metres[0]))
        results[solver_name(scans)] = (*outcome, seconds)
    return results


def weak_loop_rows(
    sequences: Sequence[Path], edges: int, hypotheses: int, max_frames: int | None, seed: int, workers: Workers
) -> Iterator[Row]:
    """A row a recording, kind of weak edge, kind of partners, number of matches (bins, then all) and solver.

    At most `edges` weak edges are drawn for each kind of edge and of partners.
    Everything but the seconds depends on the seed alone.
    """
    for folder in sequences:
        overlaps = read_overlaps(
            folder, load_settings(overrides=(f"matching.min_matches={MIN_MATCHES}",)), max_frames, workers
        )
        for k, kind in enumerate(KINDS):
            for p, partners in enumerate(PARTNERS):
                loops = draw_loops(overlaps, kind, partners, edges, np.random.default_rng([seed, k, p]))
                solved = list(
                    workers.map(
                        partial(solve_loop, overlaps=overlaps, hypotheses=hypotheses, seed=seed),
                        loops,
                        f"{overlaps.name}: {kind} edges, {partners} partners",
                        len(loops),
                    )
                )
                sizes = np.array([len(loop.matches[loop.pair]) for loop in loops])
                for low, high in (*BINS, (MIN_MATCHES, MAX_MATCHES)):
                    inside = np.flatnonzero((sizes >= low) & (sizes <= high))
                    for solver in solved[0] if len(inside) else ():
                        outcome = np.array([solved[m][solver] for m in inside])
                        yield {
                            "sequence": overlaps.name,
                            "weak": kind,
                            "partners": partners,
                            "matches": f"{low}-{high}",
                            "solver": solver,
                            "edges": len(inside),
                            "right_share": round(float(outcome[:, 0].mean()), 4),
                            "rot_deg_median": _finite(np.median(outcome[:, 1])),
                            "trans_cm_median": _finite(100 * np.median(outcome[:, 2])),
                            "hypotheses": hypotheses,
                            "cpu_ms": round(1e3 * float(outcome[:, 3].mean()), 3),
                        }


def _finite(value: float) -> float | None:
    return round(float(value), 6) if np.isfinite(value) else None


def draw_weak_loops(rows: Sequence[Row]) -> Figure:
    """Share of right edges by number of matches: a row of panels a recording, a line a solver."""
    sequences = list(dict.fromkeys(row["sequence"] for row in rows))
    cases = [(kind, partners) for kind in KINDS for partners in PARTNERS]
    figure = Figure(figsize=(13, 3.2 * max(len(sequences), 1) + 0.3), layout="constrained")
    panels = figure.subplots(max(len(sequences), 1), len(cases), sharey=True, squeeze=False)
    bins = [f"{low}-{high}" for low, high in BINS]
    for line, sequence in zip(panels, sequences, strict=False):
        for axes, (kind, partners) in zip(line, cases, strict=True):
            here = [r for r in rows if (r["sequence"], r["weak"], r["partners"]) == (sequence, kind, partners)]
            counts = {row["matches"]: row["edges"] for row in here}
            for k, solver in enumerate(dict.fromkeys(row["solver"] for row in rows)):
                mine = {row["matches"]: 100 * row["right_share"] for row in here if row["solver"] == solver}
                x = [place for place, name in enumerate(bins) if counts.get(name, 0) >= DRAWN]
                style = {"color": "black", "linewidth": 2} if solver == "pairwise" else {"color": f"C{k - 1}"}
                axes.plot(x, [mine[bins[place]] for place in x], "o-", markersize=4, label=solver, **style)
            axes.set_xticks(range(len(bins)), [f"{name}\n({counts.get(name, 0)})" for name in bins])
            axes.set_title(f"{sequence}\n{kind} edges, {partners} partners", fontsize=9)
            axes.grid(alpha=0.3)
        line[0].set_ylabel("right edges [%]")
    panels[0, -1].legend(fontsize=8)
    figure.supxlabel("matches of the edge (edges)", fontsize=9)
    return figure
