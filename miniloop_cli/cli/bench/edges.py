"""`miniloop bench edges SEQ...`: the graph solved in pairs and in cycles."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.bench.output import Row, cell, outcome, shown, write
from miniloop_cli.cli.main import CONTEXT

COLUMNS = {"edges_are": "solved in", "verified": "verified", "wrong": "wrong", "scored": "scored"}
COLUMNS |= {f"before_{name}_{kind}": f"{name} {kind}" for name in ("deg", "cm") for kind in ("mean", "median", "p95")}
COLUMNS |= {f"after_{name}_{kind}": f"-> {kind}" for name in ("deg", "cm") for kind in ("mean", "p95")}
COLUMNS |= {"cpu_s": "CPU s", "cpu_over_pairs": "x pairs"}


@click.command(
    name="edges", context_settings=CONTEXT, short_help="The graph of a recording solved in pairs and cycles."
)
@click.argument("sequences", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--longest",
    "lengths",
    multiple=True,
    type=click.IntRange(3, 7),
    default=(3, 4, 5),
    show_default=True,
    help="Longest cycle beside pairs only; may be repeated.",
)
@click.option(
    "--max-frames", type=click.IntRange(min=3), default=100, show_default=True, help="Evenly spaced frames of SEQ."
)
@outcome("edges")
@options.jobs
def bench_edges(
    sequences: tuple[Path, ...],
    lengths: tuple[int, ...],
    max_frames: int,
    output: Path | None,
    json_path: str | None,
    seed: int,
    jobs: int,
    quiet: bool,
) -> None:
    """Errors of the edges before averaging and after (->), mistakes among those verified, CPU seconds.

    SEQ: recordings with ground truth. All rows of a recording are measured on the same edges: those that each of them
    verified. Wrong: verified, and off by more than 5 deg or 10 cm.

    \b
    Example:   miniloop bench edges path/to/freiburg1_desk --longest 5
    """
    from benchmarks.experiments.edges import draw_edges, edge_rows
    from miniloop_cli.runtime.parallel import Workers

    def line(row: Row) -> str:
        return "".join(_cell(key, cell(row[key], ".3f")) for key in COLUMNS)

    found = edge_rows(sequences, lengths, max_frames, seed, Workers(jobs, quiet))
    head = "".join(_cell(key, head) for key, head in COLUMNS.items())
    rows = shown(found, head, line, json_path, by="sequence")
    write("edges", rows, partial(draw_edges, rows), output, json_path, quiet)


def _cell(key: str, text: str) -> str:
    return f"{text:<17}" if key == "edges_are" else f"{text:>11}"
