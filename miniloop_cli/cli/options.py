"""Common options of commands, and their output of JSON and long lines."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from miniloop_cli.runtime.atomic_files import atomic_write


def complete(name: str) -> Callable:
    """A completer of cli/completion.py, imported when the tab key is pressed."""

    def completer(ctx: click.Context, param: click.Parameter, incomplete: str) -> list:
        from miniloop_cli.cli import completion

        return getattr(completion, name)(ctx, param, incomplete)

    return completer


def _show_notes(ctx: click.Context, param: click.Parameter, verbose: bool) -> None:
    if verbose:
        logging.basicConfig(level=logging.WARNING, format="%(message)s")
        logging.getLogger("miniloop").setLevel(logging.INFO)


def _only_errors(ctx: click.Context, param: click.Parameter, quiet: bool) -> bool:
    logger = logging.getLogger("miniloop")
    if quiet:
        logger.setLevel(logging.ERROR)
    elif logger.level == logging.ERROR:  # set by another command in this process
        logger.setLevel(logging.NOTSET)
    return quiet


def _check_jobs(ctx: click.Context, param: click.Parameter, jobs: int) -> int:
    if jobs == 0:
        raise click.BadParameter("0 jobs do nothing; give their number, or -1 for one a core")
    return jobs


def camera(
    meaning: str = "Camera file (YAML, or of another program); replaces the camera of the recording.",
) -> Callable:
    """The option that names a camera file; `meaning` is its help."""
    return click.option("--camera", type=click.Path(path_type=Path), metavar="FILE", help=meaning)


max_frames = click.option("--max-frames", type=click.IntRange(min=1), metavar="N", help="Use N evenly spaced frames.")
seed = click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, metavar="N", help="Seed of all randomness."
)
jobs = click.option(
    "-j",
    "--jobs",
    type=click.IntRange(min=-1),
    metavar="N",
    default=-1,
    show_default=True,
    callback=_check_jobs,
    help="Parallel jobs; -1: all cores.",
)
quiet = click.option(
    "-q", "--quiet", is_flag=True, callback=_only_errors, help="No progress and no notes; errors and results only."
)
verbose = click.option(
    "-v",
    "--verbose",
    is_flag=True,
    expose_value=False,
    callback=_show_notes,
    help="Print each step and each assumption to stderr.",
)
overrides = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    shell_complete=complete("complete_assignment"),
    help="Change one setting; may be repeated.",
)
layout = click.option(
    "--layout",
    metavar="NAME",
    shell_complete=complete("complete_layout"),
    help="Layout of SEQ, if it is not recognised.",
)
topics = click.option(
    "--topics",
    metavar="LIST",
    default="",
    help="Topics of a bag, if they are not found: color=/a,depth=/b,info=/c,depth_info=/d.",
)
follow_links = click.option(
    "--follow-links", is_flag=True, help="Also read images behind symbolic links that lead out of the recording."
)
json_file = click.option("--json", "json_path", metavar="FILE|-", help="Write JSON to FILE, or to stdout with '-'.")


def output_dir(default: str) -> Callable:
    """`-o DIR`, with the default named in the help."""
    return click.option(
        "-o", "--output", type=click.Path(file_okay=False, path_type=Path), help=f"Output folder [default: {default}]."
    )


def write_json(path: str, data: Any) -> None:
    """Write JSON to a file (completely or not at all), or to stdout for '-'."""
    text = json.dumps(data, indent=1, allow_nan=False) + "\n"
    if path == "-":
        click.echo(text, nl=False)
        return
    with atomic_write(Path(path)) as file:
        file.write(text)


def wrapped(text: str, indent: str = "  ", width: int = 80) -> str:
    """A line broken at words to fit the width; further lines are indented."""
    import textwrap

    return "\n".join(
        textwrap.wrap(text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
    )
