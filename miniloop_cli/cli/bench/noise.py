"""`miniloop bench noise`: pairs and cycles against noise and wrong matches, as in the paper's synthetic experiment."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.bench.output import cell, outcome, shown, write
from miniloop_cli.cli.main import CONTEXT

COLUMNS = ("sweep", "noise", "outliers", "method", "variant", "failed", "rot_deg_median", "trans_median")
COLUMNS += ("inliers_percent_mean",)


@click.command(name="noise", context_settings=CONTEXT, short_help="Pairs and cycles against noise and wrong matches.")
@click.option(
    "--trials", type=click.IntRange(min=1), default=200, show_default=True, help="Scenes a level; paper: 1000."
)
@outcome("noise")
@options.jobs
def bench_noise(trials: int, output: Path | None, json_path: str | None, jobs: int, seed: int, quiet: bool) -> None:
    """Five cameras, pairwise and by 3-, 4- and 5-cycles: error of camera 5 seen from camera 1.

    \b
    Variants:  paper: best of 1000 hypotheses by inlier count, Procrustes on its inliers
               refined: graded scores, joint refinement on all inliers of the cycle
    Example:   miniloop bench noise --trials 50
    """
    from miniloop_cli.bench.noise import draw_noise, noise_rows

    names = (column.removesuffix("_median").removesuffix("_percent_mean") for column in COLUMNS)
    head = " ".join(f"{name:>10}" for name in names)
    found = noise_rows(trials, seed, jobs, quiet)
    rows = shown(found, head, lambda row: " ".join(f"{cell(row[column], '.4g'):>10}" for column in COLUMNS), json_path)
    write("noise", rows, partial(draw_noise, rows), output, json_path, quiet)
