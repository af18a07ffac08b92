"""`miniloop calibrate SEQ`: the camera of a recording, from the recording itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT


@click.command(context_settings=CONTEXT, short_help="The camera of a recording, from its images.")
@click.argument("sequence", metavar="SEQ", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("camera.yaml"),
    show_default=True,
    help="Camera file to write.",
)
@options.camera("Camera file to start from [default: the camera of the recording].")
@options.layout
@options.topics
@options.follow_links
@click.option(
    "--max-frames",
    type=click.IntRange(min=2),
    default=100,
    show_default=True,
    metavar="N",
    help="Use N evenly spaced frames.",
)
@options.overrides
@options.jobs
@options.seed
@options.json_file
@options.quiet
@options.verbose
def calibrate(
    sequence: Path,
    output: Path,
    camera: Path | None,
    layout: str | None,
    topics: str,
    follow_links: bool,
    max_frames: int,
    overrides: tuple[str, ...],
    jobs: int,
    seed: int,
    json_path: str | None,
    quiet: bool,
) -> None:
    """Estimate focal length, centre, lens and depth errors from the images of SEQ, and write a camera file.

    The file is for `--camera`, also with other recordings of the same device. Record objects at different
    distances, and move the camera sideways instead of only turning it.

    \b
    Example:   miniloop calibrate my_recording -o camera.yaml
               miniloop register my_recording --camera camera.yaml
    """
    from miniloop_cli.api import calibrate as run
    from miniloop_cli.datasets.intrinsics import save_camera
    from miniloop_cli.results.calibration import numbers, uncertainty

    found = run(
        sequence,
        overrides=overrides,
        layout=layout,
        topics=topics,
        follow_links=follow_links,
        camera=camera,
        max_frames=max_frames,
        jobs=jobs,
        seed=seed,
        quiet=quiet,
    )
    save_camera(output, found.camera if found.changed else found.given, uncertainty(found))
    told = numbers(found)
    if json_path:
        options.write_json(json_path, told)
    if not quiet and json_path != "-":
        _print(told, output)


def _print(told: dict[str, Any], output: Path) -> None:
    from miniloop_cli.results.calibration import in_words, rows

    for row in (("", "given", "now", "sigma", ""), *rows(told)):
        click.echo("{:<24}{:>11}{:>11}{:>10}  {}".format(*row).rstrip())
    click.echo(options.wrapped(in_words(told)))
    click.echo(f"written to {output}")
