"""`miniloop bench scenes`: recordings that defeat programs of this kind, and what miniloop says of them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.bench.output import Row, cell, outcome, shown, write
from miniloop_cli.cli.main import CONTEXT


@click.command(name="scenes", context_settings=CONTEXT, short_help="Hard scenes: right poses, or an honest no.")
@click.option("--only", "names", multiple=True, metavar="SCENE", help="Only this scene; may be repeated.")
@click.option("--frames", type=click.IntRange(min=4), default=30, show_default=True, help="Frames a scene.")
@click.option("--width", type=click.IntRange(min=160), default=640, show_default=True, help="Width of the images (px).")
@click.option("--seeds", type=click.IntRange(min=1), default=1, show_default=True, help="Rooms and paths a scene.")
@outcome("scenes")
@options.jobs
def bench_scenes(
    names: tuple[str, ...],
    frames: int,
    width: int,
    seeds: int,
    output: Path | None,
    json_path: str | None,
    jobs: int,
    seed: int,
    quiet: bool,
) -> None:
    """Simulated scenes, each with a stated right answer: frames registered, error, what is said of the others.

    The error is the rmse of positions after one rigid motion that fits orientations and positions; 2 sigma: the share
    of the errors, axis by axis, within twice the standard deviation that the run promises.

    \b
    Example:   miniloop bench scenes --only "repeated texture" --seeds 5
    """
    from benchmarks.experiments.scenes import SCENES, draw, scene_rows
    from miniloop_cli.runtime.parallel import Workers

    def line(row: Row) -> str:
        cells = f"{row['registered']:>5} of {row['frames']:<3}{cell(row['ate_cm'], '.2f'):>9}"
        cells += f"{cell(row['within_2_sigma'], '.0%'):>9}  {'yes' if row['as_expected'] else 'NO':<6}"
        return f"{row['scene']:<31}{cells}{row['verdict']}"

    found = scene_rows(names or tuple(SCENES), frames, width, range(seed, seed + seeds), Workers(jobs, quiet))
    head = f"{'scene':<31}{'registered':>11}{'error cm':>10}{'2 sigma':>9}  {'right':<6}what is said"
    rows = shown(found, head, line, json_path)
    write("scenes", rows, partial(draw, rows), output, json_path, quiet)
