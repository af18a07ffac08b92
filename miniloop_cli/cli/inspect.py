"""`miniloop inspect SEQ`: check a recording before a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT

if TYPE_CHECKING:
    from miniloop_cli.inspection.findings import Finding


@click.command(context_settings=CONTEXT, short_help="Check a recording before a run.")
@click.argument("sequence", metavar="SEQ", type=click.Path(path_type=Path))
@options.camera()
@click.option("--layout", metavar="NAME", help="Layout of SEQ, if it is not recognised.")
@options.topics
@options.follow_links
@options.json_file
@options.seed
@options.quiet
def inspect(
    sequence: Path,
    camera: Path | None,
    layout: str | None,
    topics: str,
    follow_links: bool,
    json_path: str | None,
    seed: int,
    quiet: bool,
) -> None:
    """Check a recording before a run: its properties, possible problems, and what to do about them.

    Checks stamps, images, depth range, blur, exposure and features. A sample of frames shows whether the camera,
    the depth scale and the registration of depth to colour are right.

    \b
    Example:   miniloop inspect rgbd_dataset_freiburg1_xyz
    """
    import numpy as np

    from miniloop_cli.datasets import open_sequence
    from miniloop_cli.inspection.inspect import inspect as run
    from miniloop_cli.inspection.text import describe

    recording = open_sequence(sequence, layout, camera, follow_links=follow_links, topics=topics)
    result = run(recording, np.random.default_rng(seed))
    if json_path:
        options.write_json(json_path, result.as_json())
    wrong = [finding for finding in result.findings if finding.level != "note"]
    if json_path == "-":
        return
    if not quiet:
        for name, text in describe(result.numbers):
            click.echo(f"{name:<13} {text}")
        click.echo("")
    for finding in wrong if quiet else result.findings:
        _print(finding)
    doubts = [note for note in recording.notes if note.doubtful]
    for note in doubts:
        click.echo(f"{note.kind.upper()}: {note}")
    if not (wrong or doubts or quiet):
        click.echo("Nothing looks wrong.")


def _print(finding: Finding) -> None:
    click.echo(f"{finding.level.upper()} ({finding.code}): {finding.message}")
    click.echo(f"  -> {finding.advice}")
