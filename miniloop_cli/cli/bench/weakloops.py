"""`miniloop bench weakloops SEQ...`: edges with few matches, alone and in cycles."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.bench.output import Row, cell, outcome, shown, write
from miniloop_cli.cli.main import CONTEXT

COLUMNS = {
    "weak": "weak",
    "partners": "partners",
    "matches": "matches",
    "solver": "solver",
    "edges": "edges",
    "right_share": "right",
    "rot_deg_median": "deg",
    "trans_cm_median": "cm",
    "cpu_ms": "CPU ms",
}


@click.command(name="weakloops", context_settings=CONTEXT, short_help="Edges with few matches, alone and in cycles.")
@click.argument("sequences", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--edges", "most", type=click.IntRange(min=1), default=300, show_default=True, help="Edges of each kind.")
@click.option(
    "--hypotheses", type=click.IntRange(min=1), default=2000, show_default=True, help="Tried for a pair or a cycle."
)
@click.option(
    "--max-frames", type=click.IntRange(min=3), default=100, show_default=True, help="Evenly spaced frames of SEQ."
)
@outcome("weakloops")
@options.jobs
def bench_weakloops(
    sequences: tuple[Path, ...],
    most: int,
    hypotheses: int,
    max_frames: int,
    output: Path | None,
    json_path: str | None,
    seed: int,
    jobs: int,
    quiet: bool,
) -> None:
    """Share of edges with 8 to 25 matches that come out right (5 deg and 10 cm), as pairs and in 3- to 7-cycles.

    SEQ: recordings with ground truth. Edges are thinned (of pairs with 40 matches or more so many are kept) or real;
    their partners in the cycle strong (40 matches or more) or weak as they are. Pair and cycle get the same matches,
    the same number of hypotheses and the same refinement. Only edges are counted that lie on cycles of all lengths
    and hold at least 5 true matches.

    \b
    Example:   miniloop bench weakloops path/to/freiburg1_desk --edges 100
    """
    from miniloop_cli.bench.weakloops import draw_weak_loops, weak_loop_rows
    from miniloop_cli.runtime.parallel import Workers

    def line(row: Row) -> str:
        return "".join(f"{cell(row[key], '.3g'):>10}" for key in COLUMNS)

    found = weak_loop_rows(sequences, most, hypotheses, max_frames, seed, Workers(jobs, quiet))
    rows = shown(found, "".join(f"{head:>10}" for head in COLUMNS.values()), line, json_path, by="sequence")
    write("weakloops", rows, partial(draw_weak_loops, rows), output, json_path, quiet)
