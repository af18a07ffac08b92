"""The minimal solvers on exact random problems: number of solutions, share with the true one, time of a call.

The paper's figure of the number of solutions and its table of computation times (sec. 5.1), for all solvers.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from miniloop_cli.bench import Row
from miniloop_cli.bench.problems import noisy_cycle, random_problems
from miniloop_cli.config import Ransac
from miniloop_cli.geometry import se3
from miniloop_cli.ransac.estimate import estimate
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.runtime.progress import track
from miniloop_cli.solvers import SOLVERS, load
from miniloop_cli.solvers.batch import MinimalSolver, edges_of, match_residuals
from miniloop_cli.typing import Floats

# The truth is found if errors of rotation (largest entry) and translation (relative to the cube) are smaller.
TOLERANCE = 1e-6
CHUNK = 1000
REPEATS = 3
SINGLE_CALLS = 2000
RANSAC_CALLS, RANSAC_HYPOTHESES = 10, 2000


class Paper(NamedTuple):
    """The paper's numbers of a solver: microseconds a call in Matlab, maximum number of solutions."""

    us: float | None = None
    max_solutions: int | None = None


PAPER = {
    "pairwise": Paper(39.2, 2),
    "cycle3": Paper(119.2, 4),
    "cycle4": Paper(3342.2, 16),
    "cycle5": Paper(24954.0, 32),
    "cycle6": Paper(max_solutions=288),
    "planar2": Paper(max_solutions=2),
    "planar3": Paper(max_solutions=4),
}


def _seconds(call: Callable[[int], object], count: int) -> float:
    """Time of call(0), .., call(count - 1), each the fastest of a few, as other programs only slow it down."""
    total = 0.0
    for i in range(count):
        fastest = np.inf
        for _ in range(REPEATS):
            start = time.perf_counter()
            call(i)
            fastest = min(fastest, time.perf_counter() - start)
        total += fastest
    return total


def solver_row(name: str, problems: int, rng: np.random.Generator) -> Row:
    """Measure one solver of SOLVERS on `problems` exact random cycles in a unit cube."""
    paper, upright, solver = PAPER.get(name, Paper()), SOLVERS[name].upright, load(name)
    p, q, truth = random_problems(rng, solver.matches, problems, upright=upright)
    found, residual, histogram = 0, 0.0, np.zeros(solver.max_solutions + 1, np.int64)
    for i in range(0, problems, CHUNK):
        part = slice(i, i + CHUNK)
        # Real solutions only, as on exact data the real part of a complex pair is not a solution.
        T, counts = solver.solve_batch(p[part], q[part], nearly_real=0.0)
        histogram += np.bincount(counts, minlength=len(histogram))
        error = np.abs(T - truth[part, None, :, :3]).max(axis=(2, 3, 4))
        error[np.arange(solver.max_solutions) >= counts[:, None]] = np.inf
        nearest, rows = error.argmin(axis=1), np.arange(len(counts))
        solved = counts > 0
        found += int((error[rows, nearest] < TOLERANCE).sum())
        best = T[rows, nearest][solved]
        distances = match_residuals(
            se3.pose(best[..., :3], best[..., 3]), p[part][solved], q[part][solved], solver.matches
        )
        residual = max(residual, float(distances.max(initial=0.0)))
    return {
        "solver": name,
        "matches": "+".join(map(str, solver.matches)),
        "problems": problems,
        "truth_found_share": found / problems,
        "max_solutions": int(np.flatnonzero(histogram).max(initial=0)),
        "solutions_bound": solver.max_solutions,
        "paper_max_solutions": paper.max_solutions,
        "solutions_histogram": {str(k): int(n) for k, n in enumerate(histogram) if n},
        "max_residual": residual,
        **_timings(solver, p, q),
        "ransac_ms": _ransac_ms(len(edges_of(solver.matches)), upright),
        "paper_us": paper.us,
    }


def _timings(solver: MinimalSolver, p: Floats, q: Floats) -> dict[str, float]:
    """Microseconds a call, one thread: amortised in a batch, and of the plain Python entry."""
    solver(p[0], q[0])
    chunks = [(p[i : i + CHUNK], q[i : i + CHUNK]) for i in range(0, len(p), CHUNK)]
    batch_s = _seconds(lambda i: solver.solve_batch(*chunks[i]), len(chunks))
    calls = min(SINGLE_CALLS, len(p))
    single_s = _seconds(lambda i: solver(p[i], q[i]), calls)
    return {"us_per_call_batch": 1e6 * batch_s / len(p), "us_per_call_single": 1e6 * single_s / calls}


def _ransac_ms(edges: int, upright: bool) -> float:
    """CPU milliseconds of the whole estimator on one thread, for one pair or cycle: the median of a few.

    Each edge has 200 matches, 40 % of them wrong; a fixed number of hypotheses is tried.
    """
    settings, spent = Ransac(iterations=RANSAC_HYPOTHESES, adaptive=False), []
    for k in range(RANSAC_CALLS + 1):
        problem, _ = noisy_cycle(np.random.default_rng(k), max(edges, 2), upright=upright)
        begin = time.thread_time()
        estimate(problem, settings, 16.0, np.random.default_rng(k), upright)
        spent.append(time.thread_time() - begin)
    return 1e3 * float(np.median(spent[1:]))  # the first one compiles


def solver_rows(
    problems: int, seed: int, names: Sequence[str] = tuple(SOLVERS), workers: Workers | None = None
) -> list[Row]:
    """One row a solver; each has its own generator, so rows do not depend on each other.

    `workers` only control the progress display, as times are measured on one thread.
    """
    quiet = workers is None or workers.quiet
    return [
        solver_row(name, problems, np.random.default_rng([seed, list(SOLVERS).index(name)]))
        for name in track(names, "Solvers", quiet=quiet)
    ]


def draw_histograms(rows: Sequence[Row]) -> Figure:
    """The paper's figure, how often a solver has how many real solutions: one bar a solver, divided by their number."""
    from matplotlib import colormaps

    numbers = sorted({int(number) for row in rows for number in row["solutions_histogram"]})
    colours = dict(zip(numbers, colormaps["viridis_r"](np.linspace(0.05, 0.95, len(numbers))), strict=True))
    figure = Figure(figsize=(8, 0.8 + 0.42 * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    for number in numbers:
        shares = np.array([100 * row["solutions_histogram"].get(str(number), 0) / row["problems"] for row in rows])
        left = [
            sum(100 * n / row["problems"] for k, n in row["solutions_histogram"].items() if int(k) < number)
            for row in rows
        ]
        bars = axes.barh([row["solver"] for row in rows], shares, left=left, color=colours[number], label=str(number))
        dark = colours[number][:3].mean() < 0.5
        labels = [f"{share:.3g} %" if share > 6 else "" for share in shares]
        axes.bar_label(bars, labels, label_type="center", color="white" if dark else "black", fontsize=8)
    axes.invert_yaxis()
    axes.set(xlim=(0, 100), xlabel="problems [%]", title="Number of real solutions of exact random problems")
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False, title="solutions")
    return figure
