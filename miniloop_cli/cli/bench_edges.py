"""`miniloop bench edges SEQ...`: the graph solved in pairs and in cycles."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli import options
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
@options.output_dir("results/bench_edges")
@options.json_file
@options.seed
@options.jobs
@options.quiet
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
    from miniloop_cli.bench.edges import draw_edges, edge_rows
    from miniloop_cli.parallel import Workers

    rows, tables = [], json_path != "-"
    for row in edge_rows(sequences, lengths, max_frames, seed, Workers(jobs, quiet)):
        if tables and (not rows or row["sequence"] != rows[-1]["sequence"]):
            click.echo(f"\n{row['sequence']}\n" + "".join(_cell(key, head) for key, head in COLUMNS.items()))
        if tables:
            click.echo("".join(_cell(key, _text(row[key])) for key in COLUMNS))
        rows.append(row)
    output = output or Path("results/bench_edges")
    options.write_rows(rows, output / "edges.csv", json_path)
    draw_edges(rows, output / "edges.png")
    if not quiet:
        click.echo(f"Written: {output}/edges.csv, {output}/edges.png", err=True)


def _cell(key: str, text: str) -> str:
    return f"{text:<17}" if key == "edges_are" else f"{text:>11}"


def _text(value: object) -> str:
    return "-" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)
