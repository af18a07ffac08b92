"""`miniloop add MAP SEQ`: one more recording for the map of a result."""

from __future__ import annotations

import time
from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT


@click.command(context_settings=CONTEXT, short_help="Add a recording to the map of a result.")
@click.argument("folder", metavar="MAP", type=click.Path(file_okay=False, path_type=Path))
@click.argument("sequence", metavar="SEQ", type=click.Path(path_type=Path))
@options.camera()
@options.layout
@options.topics
@options.follow_links
@options.max_frames
@click.option("--fresh", is_flag=True, help="Compute everything again; by default finished work is reused.")
@options.jobs
@options.json_file
@options.quiet
@options.verbose
def add(
    folder: Path,
    sequence: Path,
    camera: Path | None,
    layout: str | None,
    topics: str,
    follow_links: bool,
    max_frames: int | None,
    fresh: bool,
    jobs: int,
    json_path: str | None,
    quiet: bool,
) -> None:
    """Add the recording SEQ to the map of the result in MAP, as if all had been registered together.

    The settings are those of the map. The map changes in one step; if interrupted before it, it stays as it was.

    \b
    Example:   miniloop add office kitchen
    """
    from miniloop_cli import maps
    from miniloop_cli.cli.map import describe
    from miniloop_cli.runtime.allocator import KEPT_FOR_MAPS_BYTES, keep_freed_memory

    keep_freed_memory(KEPT_FOR_MAPS_BYTES)
    begin = time.perf_counter()
    numbers = maps.add(
        folder,
        sequence,
        camera=camera,
        layout=layout,
        topics=topics,
        follow_links=follow_links,
        max_frames=max_frames,
        fresh=fresh,
        jobs=jobs,
        quiet=quiet,
    )
    if json_path:
        options.write_json(json_path, numbers)
    if not quiet and json_path != "-":
        for line in describe(folder, numbers):
            click.echo(options.wrapped(line, " " * 12))
        click.echo(f"{'seconds':<12}{time.perf_counter() - begin:.1f}")
