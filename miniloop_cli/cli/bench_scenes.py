"""`miniloop bench scenes`: recordings that defeat programs of this kind, and what miniloop says of them."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT


@click.command(name="scenes", context_settings=CONTEXT, short_help="Hard scenes: right poses, or an honest no.")
@click.option("--only", "names", multiple=True, metavar="SCENE", help="Only this scene; may be repeated.")
@click.option("--frames", type=click.IntRange(min=4), default=30, show_default=True, help="Frames a scene.")
@click.option("--width", type=click.IntRange(min=160), default=640, show_default=True, help="Width of the images (px).")
@click.option("--seeds", type=click.IntRange(min=1), default=1, show_default=True, help="Rooms and paths a scene.")
@options.output_dir("results/bench_scenes")
@options.json_file
@options.jobs
@options.seed
@options.quiet
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
    from miniloop_cli.bench.scenes import SCENES, draw, scene_rows
    from miniloop_cli.parallel import Workers

    rows = []
    if json_path != "-":
        click.echo(f"{'scene':<31}{'registered':>11}{'error cm':>10}{'2 sigma':>9}  {'right':<6}what is said")
    for row in scene_rows(names or tuple(SCENES), frames, width, range(seed, seed + seeds), Workers(jobs, quiet)):
        rows.append(row)
        if json_path != "-":
            error, share = row["ate_cm"], row["within_2_sigma"]
            cells = f"{row['registered']:>5} of {row['frames']:<3}{'-' if error is None else format(error, '.2f'):>9}"
            cells += f"{'-' if share is None else format(share, '.0%'):>9}  {'yes' if row['as_expected'] else 'NO':<6}"
            click.echo(f"{row['scene']:<31}{cells}{row['verdict']}")
    output = output or Path("results/bench_scenes")
    options.write_rows(rows, output / "scenes.csv", json_path)
    draw(rows, output / "scenes.png")
    if not quiet:
        click.echo(f"Written: {output}/scenes.csv, {output}/scenes.png", err=True)
