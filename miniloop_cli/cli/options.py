"""Options that several commands share, and the one way rows are written out."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from miniloop_cli.files import atomic_write

seed = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of all randomness.")
jobs = click.option("-j", "--jobs", type=int, default=-1, show_default=True, help="Parallel jobs; -1: all cores.")
quiet = click.option("-q", "--quiet", is_flag=True, help="No progress and no notes; errors and results only.")
json_file = click.option("--json", "json_path", metavar="FILE|-", help="Write JSON to FILE, or to stdout with '-'.")


def output_dir(default: str) -> Callable:
    """`-o DIR`, with the default named in the help."""
    return click.option(
        "-o", "--output", type=click.Path(file_okay=False, path_type=Path), help=f"Output folder [default: {default}]."
    )


def write_json(path: str, data: Any) -> None:
    """JSON to a file (whole or not at all), or to stdout for '-'."""
    text = json.dumps(data, indent=1, allow_nan=False) + "\n"
    if path == "-":
        click.echo(text, nl=False)
        return
    with atomic_write(Path(path)) as file:
        file.write(text)


def write_rows(rows: Sequence[dict[str, Any]], csv_path: Path | None = None, json_path: str | None = None) -> None:
    """Rows of a benchmark as CSV (union of the keys, in order of appearance) and as {"rows": [...]} JSON."""
    if csv_path:
        with atomic_write(csv_path) as file:
            writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    if json_path:
        write_json(json_path, {"rows": list(rows)})
