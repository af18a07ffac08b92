"""`miniloop map`: the content of a result's map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT

MAP = click.Path(file_okay=False, path_type=Path)


@click.group(context_settings=CONTEXT, short_help="The map of a result: show it, remove a recording.")
def map_group() -> None:
    """The map of a result, which `miniloop locate` and `miniloop add` use.

    \b
    Example:   miniloop map info results/desk
    """


@map_group.command(context_settings=CONTEXT, short_help="What a map holds.")
@click.argument("folder", metavar="DIR", type=MAP)
@options.json_file
def info(folder: Path, json_path: str | None) -> None:
    """List the content of the map of the result in DIR, and check each of its files.

    \b
    Example:   miniloop map info results/desk
    """
    from miniloop_cli.results.map_folder import map_bytes, read_manifest, read_map
    from miniloop_cli.results.map_numbers import map_numbers

    content = read_manifest(folder)
    numbers = map_numbers(read_map(folder), map_bytes(content), content)
    if json_path:
        options.write_json(json_path, numbers)
    if json_path != "-":
        for line in describe(folder, numbers):
            click.echo(options.wrapped(line, " " * 12))


@map_group.command(context_settings=CONTEXT, short_help="Take a recording out of a map.")
@click.argument("folder", metavar="DIR", type=MAP)
@click.argument("name", metavar="RECORDING")
@options.jobs
@options.json_file
@options.quiet
def remove(folder: Path, name: str, jobs: int, json_path: str | None, quiet: bool) -> None:
    """Remove RECORDING from the map of the result in DIR, and its folder from DIR.

    \b
    Example:   miniloop map remove office kitchen
    """
    from miniloop_cli import maps

    numbers = maps.remove(folder, name, jobs=jobs, quiet=quiet)
    if json_path:
        options.write_json(json_path, numbers)
    if not quiet and json_path != "-":
        for line in describe(folder, numbers):
            click.echo(options.wrapped(line, " " * 12))


def describe(folder: Path, numbers: dict[str, Any]) -> list[str]:
    """The numbers as lines for people."""
    kilobytes = numbers["bytes"] / 1000 / max(numbers["keyframes"], 1)
    lines = [
        f"{'map':<12}{folder}, version {numbers['version']}, written by miniloop {numbers['miniloop']}",
        f"{'size':<12}{numbers['bytes'] / 1e6:.1f} MB: {kilobytes:.0f} kB a keyframe",
        f"{'keyframes':<12}{numbers['keyframes']} with {numbers['features']} features ({numbers['feature_type']})",
        f"{'points':<12}{numbers['points']} seen by two keyframes and more, median sigma"
        f" {100 * numbers['point_sigma_m']:.2f} cm",
    ]
    for recording in numbers["recordings"]:
        piece = f", piece {recording['piece']}" if numbers["pieces"] > 1 else ""
        lines.append(
            f"{'recording':<12}{recording['name']}: {recording['registered']} of {recording['frames']} frames,"
            f" {recording['keyframes']} keyframes{piece} ({recording['source']})"
        )
    for joint in numbers["joins"]:
        lines.append(f"{'joined':<12}{joint['a']} and {joint['b']} by {joint['edges']} edges")
    if numbers["pieces"] > 1:
        lines.append(f"{'pieces':<12}{numbers['pieces']}, not joined to each other")
    lines += [f"{'note':<12}{note}" for note in numbers["notes"]]
    if verdict := numbers.get("verdict"):  # of a map of several recordings; a single one has its own summary
        first, *others = verdict["reasons"] or ["no check contradicts it"]
        lines += [f"{verdict['level']:<12}{first}", *(f"{'':<12}{reason}" for reason in others)]
    return lines
