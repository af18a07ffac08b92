"""The minimal solvers on exact random problems: how many solutions, is the truth among them, how long does a call take.

The paper's figure of the number of solutions and its table of computation times (sec. 5.1), for all solvers.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from types import ModuleType
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
from miniloop_cli.solvers.batch import edges_of, match_residuals
from miniloop_cli.typing import Floats

# Truth counts as found if rotation (largest entry) and translation (relative to the cube) agree so well.
TOLERANCE = 1e-6
CHUNK = 1000
REPEATS = 3
SINGLE_CALLS = 2000
RANSAC_CALLS, RANSAC_HYPOTHESES = 10, 2000


class Entry(NamedTuple):
    """A solver under test; of the paper: microseconds a call in Matlab, maximum number of solutions."""

    upright: bool = False
    paper_us: float | None = None
    paper_max_solutions: int | None = None


# A solver is its module in miniloop_cli.solvers; to measure another one, name it here.
SOLVERS: dict[str, Entry] = {
    "pairwise": Entry(paper_us=39.2, paper_max_solutions=2),
    "cycle3": Entry(paper_us=119.2, paper_max_solutions=4),
    "cycle4": Entry(paper_us=3342.2, paper_max_solutions=16),
    "cycle5": Entry(paper_us=24954.0, paper_max_solutions=32),
    "planar2": Entry(upright=True, paper_max_solutions=2),
    "planar3": Entry(upright=True, paper_max_solutions=4),
    "planar4": Entry(upright=True),
    # Behind the others: a row's random problems follow from its place.
    "cycle6": Entry(paper_max_solutions=288),
    "cycle7": Entry(),
}


LONG = ("cycle6", "cycle7")


def _seconds(call: Callable[[int], object], count: int) -> float:
    """Time of call(0), .., call(count - 1), each the fastest of a few: other programs only ever slow it down."""
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
    entry = SOLVERS[name]
    module = importlib.import_module(f"miniloop_cli.solvers.{'long_cycles.' * (name in LONG)}{name}")
    p, q, truth = random_problems(rng, module.MATCHES, problems, upright=entry.upright)
    # Real solutions only: on exact data the real part of a complex pair is no solution.
    exactly = {"nearly_real": 0.0} if hasattr(module, "solve_within") else {}
    found, residual, histogram = 0, 0.0, np.zeros(module.MAX_SOLUTIONS + 1, np.int64)
    for i in range(0, problems, CHUNK):
        part = slice(i, i + CHUNK)
        T, counts = module.solve_batch(p[part], q[part], **exactly)
        histogram += np.bincount(counts, minlength=len(histogram))
        error = np.abs(T - truth[part, None, :, :3]).max(axis=(2, 3, 4))
        error[np.arange(module.MAX_SOLUTIONS) >= counts[:, None]] = np.inf
        nearest, rows = error.argmin(axis=1), np.arange(len(counts))
        solved = counts > 0
        found += int((error[rows, nearest] < TOLERANCE).sum())
        best = T[rows, nearest][solved]
        distances = match_residuals(
            se3.pose(best[..., :3], best[..., 3]), p[part][solved], q[part][solved], module.MATCHES
        )
        residual = max(residual, float(distances.max(initial=0.0)))
    return {
        "solver": name,
        "matches": "+".join(map(str, module.MATCHES)),
        "problems": problems,
        "truth_found_share": found / problems,
        "max_solutions": int(np.flatnonzero(histogram).max(initial=0)),
        "solutions_bound": module.MAX_SOLUTIONS,
        "paper_max_solutions": entry.paper_max_solutions,
        "solutions_histogram": {str(k): int(n) for k, n in enumerate(histogram) if n},
        "max_residual": residual,
        **_timings(module, name, p, q),
        "ransac_ms": _ransac_ms(len(edges_of(module.MATCHES)), entry.upright),
        "paper_us": entry.paper_us,
    }


def _timings(module: ModuleType, name: str, p: Floats, q: Floats) -> dict[str, float]:
    """Microseconds a call, one thread: amortised in a batch, and of the plain Python entry."""
    single = getattr(module, name)
    single(p[0], q[0])
    chunks = [(p[i : i + CHUNK], q[i : i + CHUNK]) for i in range(0, len(p), CHUNK)]
    batch_s = _seconds(lambda i: module.solve_batch(*chunks[i]), len(chunks))
    calls = min(SINGLE_CALLS, len(p))
    single_s = _seconds(lambda i: single(p[i], q[i]), calls)
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
    """One row a solver; each draws its problems from a generator of its own: rows do not depend on each other.

    `workers` say whether progress is shown: seconds are measured on one thread.
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
