"""`miniloop bench averaging`: motion averaging on view graphs with known poses."""

from __future__ import annotations

from functools import partial
from itertools import chain
from pathlib import Path

import click

from miniloop_cli.cli.bench.output import cell, outcome, shown, write
from miniloop_cli.cli.main import CONTEXT

COLUMNS = {
    "method": "method",
    "kind": "kind",
    "scans": "scans",
    "edges": "edges",
    "outliers": "outliers",
    "seconds": "seconds",
    "rotation_seconds": "rotation s",
    "rot_err_deg_median": "median deg",
    "rot_err_deg_mean": "mean deg",
    "trans_err_median": "median m",
    "peak_mb": "peak MB",
    "converged": "converged",
}


def _share(ctx: click.Context, parameter: click.Parameter, values: tuple[float, ...]) -> tuple[float, ...]:
    """0.05 and 5 both mean five of a hundred edges."""
    shares = tuple(value / 100 if value >= 1 else value for value in values)
    if any(not 0 <= share < 1 for share in shares):
        raise click.BadParameter("a share of the edges (0.05) or percent (5), below all of them")
    return shares


@click.command(name="averaging", context_settings=CONTEXT, short_help="Motion averaging on graphs with known poses.")
@click.option("--scans", type=click.IntRange(min=2), multiple=True, default=(100, 1000, 10_000), show_default=True)
@click.option("--edges", type=click.IntRange(min=1), help="Edges of each graph [default: 5 a scan].")
@click.option(
    "--outliers",
    type=float,
    multiple=True,
    default=(0.05,),
    show_default=True,
    callback=_share,
    help="Share of edges with a random relative pose (0.05), or percent (5).",
)
@click.option("--kind", type=click.Choice(["video", "expander"]), multiple=True, default=("video",), show_default=True)
@click.option("--noise-deg", type=click.FloatRange(min=0), default=0.5, show_default=True, help="Along each axis.")
@click.option("--noise-m", type=click.FloatRange(min=0), default=0.01, show_default=True, help="Along each axis.")
@click.option("--peers", is_flag=True, help="Also pycolmap and, up to 1000 scans, gtsam, where installed.")
@outcome("averaging")
def bench_averaging(
    scans: tuple[int, ...],
    edges: int | None,
    outliers: tuple[float, ...],
    kind: tuple[str, ...],
    noise_deg: float,
    noise_m: float,
    peers: bool,
    output: Path | None,
    json_path: str | None,
    seed: int,
    quiet: bool,
) -> None:
    """Rotation and translation averaging on graphs with known poses: time, error, memory.

    Options that name a graph can be given several times; every combination is measured.

    \b
    Example:   miniloop bench averaging --scans 10000 --edges 50000 --outliers 0.1 --kind expander
    """
    from benchmarks.experiments.averaging import averaging_rows, draw
    from miniloop_cli.runtime.progress import track

    graphs = [(k, n, edges or min(5 * n, n * (n - 1) // 2), share) for k in kind for share in outliers for n in scans]
    found = [
        averaging_rows(*graph, noise_deg, noise_m, seed, peers) for graph in track(graphs, "View graphs", quiet=quiet)
    ]
    head = "".join(f"{head:>12}" for head in COLUMNS.values())
    rows = shown(chain(*found), head, lambda row: "".join(f"{cell(row[key], '.4g'):>12}" for key in COLUMNS), json_path)
    write("averaging", rows, partial(draw, rows), output, json_path, quiet)
