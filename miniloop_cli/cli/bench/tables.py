"""`miniloop bench tables SEQ...`: the paper's tables of cycles and of final errors, on these recordings."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.bench.output import outcome, write
from miniloop_cli.cli.main import CONTEXT


@click.command(name="tables", context_settings=CONTEXT, short_help="The paper's tables: cycles and final errors.")
@click.argument("sequences", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--config",
    default="paper",
    show_default=True,
    help="Preset or file that says what is detected and matched for the graph (paper: SURF).",
)
@outcome("tables")
@options.jobs
def bench_tables(
    sequences: tuple[Path, ...],
    config: str,
    output: Path | None,
    json_path: str | None,
    jobs: int,
    seed: int,
    quiet: bool,
) -> None:
    """Cycles of the overlap graph at several T, and errors of the final poses over its edges.

    SEQ: recordings with ground truth. The paper does not give its T: the errors are measured over the graph with the
    paper's number of edges (for other recordings with its middle sequence's share of the pairs), all of them, whether
    a run used them or not.

    \b
    Example:   miniloop bench tables path/to/freiburg1_xyz
    """
    from miniloop_cli.bench.tables import draw, table_rows
    from miniloop_cli.runtime.parallel import Workers

    rows = []
    for folder in sequences:
        found = table_rows(folder, config, seed, Workers(jobs, quiet))
        if json_path != "-":
            _print(found)
        rows += found
    write("tables", rows, partial(draw, rows), output, json_path, quiet)


def _print(rows: Sequence[dict[str, Any]]) -> None:
    from miniloop_cli.bench.tables import CYCLE_COLUMNS

    cycles, errors = ([row for row in rows if row["table"] == name] for name in ("cycles", "errors"))
    click.echo(f"\n{rows[0]['sequence']}, --config {rows[0]['config']} (paper's in brackets)")
    click.echo(f"{'T':>6}{'edges':>8}  {'decomposition':<15}" + "".join(f"{name:>12}" for name in CYCLE_COLUMNS))
    for row in cycles:
        cells = [_text(row[name], row[f"paper_{name}"], "d") for name in CYCLE_COLUMNS]
        head = f"{row['min_matches']:>6}{row['edges']:>8}  {row['decomposition']:<15}"
        click.echo(head + "".join(f"{cell:>12}" for cell in cells))
    heads = ("registered", "edges", "deg", "cm", "estimates deg", "estimates cm")
    click.echo(f"\n{'mean errors':<25}" + "".join(f"{head:>15}" for head in heads))
    for row in errors:
        cells = [f"{row['registered']} of {row['frames']}", f"{row['edges_scored']} of {row['edges']}"]
        cells += [_text(row[key], row[f"paper_{key}"], ".2f") for key in ("rot_deg_mean", "trans_cm_mean")]
        cells += [_text(row[f"estimate_{key}"], None, ".2f") for key in ("rot_deg_mean", "trans_cm_mean")]
        click.echo(f"{row['run']:<25}" + "".join(f"{cell:>15}" for cell in cells))


def _text(value: float | None, paper: float | None, form: str) -> str:
    if value is None:
        return "-"
    return f"{value:{form}}" if paper is None else f"{value:{form}} ({paper:{form}})"
