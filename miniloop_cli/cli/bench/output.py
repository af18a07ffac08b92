"""What the commands of `miniloop bench` share: options, rows that are shown as they come, the files they leave."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import click

from miniloop_cli.cli import options
from miniloop_cli.runtime.atomic_files import atomic_write

Row = dict[str, Any]
FOLDER = "results/bench_{}"


def outcome(name: str) -> Callable:
    """-o, --json, --seed and -q of the benchmark `name`."""

    def decorated(command: Callable) -> Callable:
        for option in (options.quiet, options.seed, options.json_file, options.output_dir(FOLDER.format(name))):
            command = option(command)
        return command

    return decorated


def cell(value: object, form: str) -> str:
    """Text of a number: `form` is for those with a decimal point; "-" where there is none."""
    return "-" if value is None else format(value, form) if isinstance(value, float) else str(value)


def shown(
    rows: Iterable[Row], head: str, line: Callable[[Row], str], json_path: str | None, by: str | None = None
) -> list[Row]:
    """All rows, each as a line once it is there, under a head; where they change in `by`, its value and a new head.

    Nothing is printed where the JSON goes to stdout.
    """
    found: list[Row] = []
    for row in rows:
        if json_path != "-":
            if not found or (by and row[by] != found[-1][by]):
                click.echo(f"\n{row[by]}\n{head}" if by else head)
            click.echo(line(row))
        found.append(row)
    return found


def write(
    name: str,
    rows: Sequence[Row],
    draw: Callable[[Path], None],
    output: Path | None,
    json_path: str | None,
    quiet: bool,
) -> None:
    """NAME.csv (union of the keys, in order of appearance), {"rows": [...]} as JSON where it is asked for, NAME.png."""
    table, picture = ((output or Path(FOLDER.format(name))) / f"{name}.{ending}" for ending in ("csv", "png"))
    with atomic_write(table) as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    if json_path:
        options.write_json(json_path, {"rows": list(rows)})
    draw(picture)
    if not quiet:
        click.echo(f"Written: {table}, {picture}", err=True)
