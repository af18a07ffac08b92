"""`miniloop bench noise`: pairs and cycles against noise and wrong matches, as in the paper's synthetic experiment."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT

COLUMNS = ("sweep", "noise", "outliers", "method", "variant", "failed", "rot_deg_median", "trans_median")
COLUMNS += ("inliers_percent_mean",)


@click.command(name="noise", context_settings=CONTEXT, short_help="Pairs and cycles against noise and wrong matches.")
@click.option(
    "--trials", type=click.IntRange(min=1), default=200, show_default=True, help="Scenes a level; paper: 1000."
)
@options.output_dir("results/bench_noise")
@options.json_file
@options.jobs
@options.seed
@options.quiet
def bench_noise(trials: int, output: Path | None, json_path: str | None, jobs: int, seed: int, quiet: bool) -> None:
    """Five cameras, pairwise and by 3-, 4- and 5-cycles: error of camera 5 seen from camera 1.

    \b
    Variants:  paper: best of 1000 hypotheses by inlier count, Procrustes on its inliers
               refined: graded scores, joint refinement on all inliers of the cycle
    Example:   miniloop bench noise --trials 50
    """
    from miniloop_cli.bench.noise import draw_noise, noise_rows

    rows = noise_rows(trials, seed, jobs, quiet)
    output = output or Path("results/bench_noise")
    options.write_rows(rows, output / "noise.csv", json_path)
    draw_noise(rows, output / "noise.png")
    if json_path != "-":
        click.echo(
            " ".join(f"{column.removesuffix('_median').removesuffix('_percent_mean'):>10}" for column in COLUMNS)
        )
        for row in rows:
            click.echo(" ".join(f"{_text(row[column]):>10}" for column in COLUMNS))
    if not quiet:
        click.echo(f"Written: {output}/noise.csv, {output}/noise.png", err=True)


def _text(value: object) -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
