"""The command of a benchmark: its options, its rows on the screen, and its files."""

from __future__ import annotations

import csv
import importlib
import string
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import click

from miniloop_cli.bench import Row
from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT
from miniloop_cli.runtime.atomic_files import atomic_write

FOLDER = "results/bench_{}"


class Column(NamedTuple):
    """A column on the screen: its head, the text of a cell ("{rot_deg:.2f}"), alignment and width ("<24")."""

    head: str
    cell: str
    place: str


def numbers(place: str, form: str, *names: str, **heads: str) -> tuple[Column, ...]:
    """Columns that differ in key and head only: of `names`, which are both, then of `heads` (key=head).

    `form` is for values with a decimal point.
    """
    return tuple(
        Column(head, f"{{{key}:{form}}}", place) for key, head in (dict(zip(names, names, strict=True)) | heads).items()
    )


def whole(name: str, least: int, default: int, meaning: str) -> Callable:
    """An option `name` that is a whole number, at least `least`."""
    return click.option(
        name, type=click.IntRange(min=least), metavar="N", default=default, show_default=True, help=meaning
    )


def several(name: str, kind: click.ParamType, default: Sequence[Any], meaning: str) -> Callable:
    """An option `name` that may be repeated."""
    meaning = f"{meaning} May be repeated."
    return click.option(name, type=kind, multiple=True, default=default, show_default=True, help=meaning)


@dataclass(frozen=True)
class Benchmark:
    """A measurement and the layout of its command.

    `rows` and `draw` are "module:function", imported when the command runs. The first makes the rows from the values of
    the `options`, the `seed` and the `workers`. The second makes a figure of the rows.
    A row shows those `columns` whose keys it has. `heading`, with the row's values, is printed above the rows whenever
    it changes. Without `parallel` there is no --jobs.
    """

    name: str
    summary: str
    help: str
    rows: str
    draw: str
    columns: tuple[Column, ...]
    options: tuple[Callable, ...] = ()
    heading: str = ""
    parallel: bool = True


def command(benchmark: Benchmark) -> click.Command:
    """The benchmark as a command."""

    def run(output: Path | None, json_path: str | None, seed: int, quiet: bool, jobs: int = 1, **chosen: Any) -> None:
        from miniloop_cli.runtime.parallel import Workers

        make, draw = _imported(benchmark.rows), _imported(benchmark.draw)
        rows = _shown(benchmark, make(**chosen, seed=seed, workers=Workers(jobs, quiet)), silent=json_path == "-")
        _write(benchmark.name, rows, draw, output, json_path, quiet)

    outcome = (options.output_dir(FOLDER.format(benchmark.name)), options.json_file, options.seed, options.quiet)
    for option in reversed([*benchmark.options, *outcome, *([options.jobs] if benchmark.parallel else [])]):
        option(run)
    named = click.command(benchmark.name, context_settings=CONTEXT, help=benchmark.help, short_help=benchmark.summary)
    return named(run)


def _imported(name: str) -> Callable[..., Any]:
    module, attribute = name.split(":")
    return getattr(importlib.import_module(module), attribute)


class _Text(string.Formatter):
    """None is "-", true "yes", false "no"; the format is applied to numbers with a decimal point only."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, bool):
            return "yes" if value else "no"
        if value is None:
            return "-"
        return format(value, format_spec) if isinstance(value, float) else str(value)


def _text(template: str, row: Row) -> str:
    """The template with the row's values; a bracket at its end without values is left out."""
    return _Text().vformat(template, (), row).removesuffix(" (-)")


def _keys(template: str) -> set[str]:
    return {key for _, key, _, _ in string.Formatter().parse(template) if key}


def _shown(benchmark: Benchmark, rows: Iterable[Row], silent: bool) -> list[Row]:
    """All rows, each printed as a line when it is ready, unless JSON goes to stdout."""
    found: list[Row] = []
    heading, columns = "", list[Column]()
    for row in rows:
        found.append(row)
        if silent:
            continue
        above, here = _text(benchmark.heading, row), [c for c in benchmark.columns if _keys(c.cell) <= row.keys()]
        if above != heading:
            click.echo(f"\n{above}")
        elif here != columns and columns:
            click.echo()
        if (above, here) != (heading, columns):
            click.echo("".join(format(column.head, column.place) for column in here))
        click.echo("".join(format(_text(column.cell, row), column.place) for column in here))
        heading, columns = above, here
    return found


def _write(
    name: str, rows: Sequence[Row], draw: Callable[..., Any], output: Path | None, json_path: str | None, quiet: bool
) -> None:
    """NAME.csv (union of the keys, in order of appearance), {"rows": [...]} as JSON if requested, NAME.png."""
    from miniloop_cli.evaluation.plots import save

    table, picture = ((output or Path(FOLDER.format(name))) / f"{name}.{ending}" for ending in ("csv", "png"))
    with atomic_write(table) as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    if json_path:
        options.write_json(json_path, {"rows": rows})
    save(draw(rows), picture)
    if not quiet:
        click.echo(f"Written: {table}, {picture}", err=True)
