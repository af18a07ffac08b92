"""`miniloop bench solvers`: solutions, accuracy and speed of the minimal solvers."""

from __future__ import annotations

from functools import partial
from itertools import chain
from pathlib import Path

import click

from miniloop_cli.cli.bench.output import cell, outcome, shown, write
from miniloop_cli.cli.main import CONTEXT

COLUMNS = {
    "solver": "solver",
    "matches": "matches",
    "solutions_bound": "max",
    "paper_max_solutions": "paper",
    "max_solutions": "seen",
    "truth_found_share": "truth found",
    "max_residual": "residual",
    "us_per_call_batch": "us batch",
    "us_per_call_single": "us single",
    "paper_us": "us paper",
    "ransac_ms": "ransac ms",
}


@click.command(name="solvers", context_settings=CONTEXT, short_help="Solutions, truth found and time of the solvers.")
@click.option("--problems", type=click.IntRange(min=1), default=100_000, show_default=True, help="Problems a solver.")
@outcome("solvers")
def bench_solvers(problems: int, output: Path | None, json_path: str | None, seed: int, quiet: bool) -> None:
    """Minimal solvers on exact random cycles: number of solutions, truth found, time a call.

    ransac ms: the joint estimator on one pair or cycle of 200 matches an edge, 40 % of them wrong, 2000 hypotheses.

    \b
    Example:   miniloop bench solvers --problems 10000
    """
    from miniloop_cli.bench.solvers import draw_histograms, solver_rows
    from miniloop_cli.runtime.progress import track
    from miniloop_cli.solvers import SOLVERS

    found = [solver_rows(problems, seed, [name]) for name in track(list(SOLVERS), "Solvers", quiet=quiet)]
    head = " ".join(f"{head:>13}" for head in COLUMNS.values())
    rows = shown(
        chain(*found), head, lambda row: " ".join(f"{cell(row[key], '.4g'):>13}" for key in COLUMNS), json_path
    )
    write("solvers", rows, partial(draw_histograms, rows), output, json_path, quiet)
