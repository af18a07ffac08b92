"""`miniloop register SEQ`: from a recording to poses, a model and the evidence."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT

if TYPE_CHECKING:
    from miniloop_cli.pipeline import Registration

FEATURES = ("rootsift", "sift", "orb", "surf", "akaze", "brisk")


@click.command(context_settings=CONTEXT)
@click.argument("sequence", metavar="SEQ", type=click.Path(path_type=Path))
@options.output_dir("results/<name of SEQ>")
@click.option(
    "--config",
    default="default",
    show_default=True,
    metavar="NAME|FILE",
    help="default, paper, fast, accurate, or a YAML file.",
)
@click.option("--features", type=click.Choice(FEATURES), help="Detector and descriptor.")
@click.option(
    "--camera", type=click.Path(path_type=Path), metavar="FILE", help="Intrinsics (YAML) instead of those found."
)
@click.option("--layout", metavar="NAME", help="Layout of SEQ, if looking at the folder is not enough.")
@click.option("--max-frames", type=click.IntRange(min=1), metavar="N", help="Use N evenly spaced frames.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change one setting; may be repeated.")
@click.option("--fresh", is_flag=True, help="Make everything again; by default finished work is taken up.")
@options.jobs
@options.seed
@options.quiet
def register(
    sequence: Path,
    output: Path | None,
    config: str,
    features: str | None,
    camera: Path | None,
    layout: str | None,
    max_frames: int | None,
    overrides: tuple[str, ...],
    fresh: bool,
    jobs: int,
    seed: int,
    quiet: bool,
) -> None:
    """Register the scans of SEQ: poses of all frames, one model, and the evidence for them.

    \b
    Example:   miniloop register rgbd_dataset_freiburg1_xyz
               miniloop eval --gt rgbd_dataset_freiburg1_xyz
    """
    from miniloop_cli.api import register as run_register

    if features:
        overrides = (f"features.type={features}", *overrides)
    run = run_register(
        sequence,
        output,
        settings=config,
        overrides=overrides,
        layout=layout,
        camera=camera,
        max_frames=max_frames,
        jobs=jobs,
        seed=seed,
        fresh=fresh,
        quiet=quiet,
    )
    if not quiet:
        print_summary(run, output or Path("results") / run.sequence.name)


def print_summary(run: Registration, folder: Path) -> None:
    """What was found, in a few lines that fit 80 columns."""
    from miniloop_cli.export.results import reason, summary

    numbers = summary(run)
    cycles = ", ".join(f"{count} by {kind}{'-cycles' * kind.isdigit()}" for kind, count in numbers["cycles"].items())
    seconds = ", ".join(f"{stage} {value:.1f}" for stage, value in run.timings_s.items())
    click.echo(f"registered  {numbers['registered']} of {numbers['frames']} frames")
    click.echo(f"camera      {numbers['camera']}")
    click.echo(f"edges       {numbers['edges']} verified; solved: {cycles}")
    click.echo(f"seconds     {seconds}")
    click.echo(f"results     {folder}")
    missing = [index for index in range(numbers["frames"]) if run.poses.component[index] != 0]
    for index in missing[:10]:
        click.echo(
            f"frame {index} ({run.sequence.frames[index].timestamp_s:.6f}) is not registered: {reason(run, index)}"
        )
    if len(missing) > 10:
        click.echo(f"... and {len(missing) - 10} more: see frames.csv")
