"""`miniloop bench recall SEQ...`: what choosing candidates loses against comparing all pairs exactly."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.bench.output import Row, outcome, shown, write
from miniloop_cli.cli.main import CONTEXT

COLUMNS = {"candidates": "candidates", "verified": "verified", "kept": "kept", "matching_cpu_s": "matching CPU s"}
COLUMNS |= {"matching_share": "share", "registered": "registered", "ate_cm": "ATE cm"}


@click.command(name="recall", context_settings=CONTEXT, short_help="Edges that choosing candidates loses.")
@click.argument("sequences", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--max-frames", type=click.IntRange(min=3), default=100, show_default=True, help="Evenly spaced frames of SEQ."
)
@options.overrides
@outcome("recall")
@options.jobs
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
    from benchmarks.experiments.recall import draw_recall, recall_rows
    from miniloop_cli.runtime.parallel import Workers

    def line(row: Row) -> str:
        return "".join(f"{'-' if row[key] is None else row[key]:>15}" for key in COLUMNS)

    found = recall_rows(sequences, max_frames, overrides, seed, Workers(jobs, quiet))
    rows = shown(found, "".join(f"{head:>15}" for head in COLUMNS.values()), line, json_path, by="sequence")
    write("recall", rows, partial(draw_recall, rows), output, json_path, quiet)
