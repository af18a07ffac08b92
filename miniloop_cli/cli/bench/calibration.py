"""`miniloop bench calibration`: are errors what the covariances of the poses promise?"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.bench.output import Row, cell, outcome, shown, write
from miniloop_cli.cli.main import CONTEXT


@click.command(name="calibration", context_settings=CONTEXT, short_help="Errors in units of what is promised.")
@click.option(
    "--frames", type=click.IntRange(min=3), multiple=True, default=(16, 32), show_default=True, help="Repeatable."
)
@click.option(
    "--noise", type=float, multiple=True, default=(0.5, 1.0, 2.0), show_default=True, help="Times a Kinect's."
)
@click.option("--seeds", type=click.IntRange(min=1), default=2, show_default=True, help="Recordings of each kind.")
@click.option("--width", type=click.IntRange(min=160), default=320, show_default=True, help="Width of the images (px).")
@outcome("calibration")
@options.jobs
def bench_calibration(
    frames: tuple[int, ...],
    noise: tuple[float, ...],
    seeds: int,
    width: int,
    output: Path | None,
    json_path: str | None,
    jobs: int,
    seed: int,
    quiet: bool,
) -> None:
    """The share of pose errors within two of their own standard deviations, over paths, noise and numbers of frames.

    Every error is one of six of a pose (rotation and translation along its camera's axes), relative to the frame that
    the run holds fixed. 95.4 % if everything were Gaussian.

    \b
    Example:   miniloop bench calibration --seeds 5 --noise 1 --frames 30
    """
    from benchmarks.experiments.calibration import PATHS, calibration_cells, draw
    from miniloop_cli.runtime.parallel import Workers

    cells = []

    def rows() -> Iterator[Row]:
        for found in calibration_cells(PATHS, noise, frames, range(seed, seed + seeds), width, Workers(jobs, quiet)):
            cells.append(found)
            yield found.row

    def line(row: Row) -> str:
        share, error, promised = row["within_2_sigma"], row["error_cm_rms"], row["promised_cm_rms"]
        text = f"{row['path']:<13}{row['noise']:>6g}{row['frames']:>7}{row['poses']:>7}"
        return f"{text}{cell(share, '.0%'):>9}{cell(error, '.3f'):>10}{cell(promised, '.3f'):>10}"

    head = f"{'path':<13}{'noise':>6}{'frames':>7}{'poses':>7}{'2 sigma':>9}{'error cm':>10}{'promised':>10}"
    found = shown(rows(), head, line, json_path)
    write("calibration", found, partial(draw, cells), output, json_path, quiet)
