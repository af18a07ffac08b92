"""`miniloop bench recall SEQ...`: what choosing candidates loses against comparing all pairs exactly."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT

COLUMNS = {"candidates": "candidates", "verified": "verified", "kept": "kept", "matching_cpu_s": "matching CPU s"}
COLUMNS |= {"matching_share": "share", "registered": "registered", "ate_cm": "ATE cm"}


@click.command(name="recall", context_settings=CONTEXT, short_help="Edges that choosing candidates loses.")
@click.argument("sequences", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--max-frames", type=click.IntRange(min=3), default=100, show_default=True, help="Evenly spaced frames of SEQ."
)
@options.overrides
@options.output_dir("results/bench_recall")
@options.json_file
@options.seed
@options.jobs
@options.quiet
def bench_recall(
    sequences: tuple[Path, ...],
    max_frames: int,
    overrides: tuple[str, ...],
    output: Path | None,
    json_path: str | None,
    seed: int,
    jobs: int,
    quiet: bool,
) -> None:
    """Compare all pairs exactly, then by sketches (auto), then only pairs that are near or look alike (retrieval).

    Kept: share of the edges verified by the first way that are verified by another; share: of its CPU seconds.

    \b
    Example:   miniloop bench recall path/to/freiburg1_desk
    """
    from miniloop_cli.bench.recall import draw_recall, recall_rows
    from miniloop_cli.parallel import Workers

    rows, tables = [], json_path != "-"
    for row in recall_rows(sequences, max_frames, overrides, seed, Workers(jobs, quiet)):
        if tables and (not rows or row["sequence"] != rows[-1]["sequence"]):
            click.echo(f"\n{row['sequence']}\n" + "".join(f"{head:>15}" for head in COLUMNS.values()))
        if tables:
            click.echo("".join(f"{'-' if row[key] is None else row[key]:>15}" for key in COLUMNS))
        rows.append(row)
    output = output or Path("results/bench_recall")
    options.write_rows(rows, output / "recall.csv", json_path)
    draw_recall(rows, output / "recall.png")
    if not quiet:
        click.echo(f"Written: {output}/recall.csv, {output}/recall.png", err=True)
