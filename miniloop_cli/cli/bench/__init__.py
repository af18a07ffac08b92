"""`miniloop bench NAME`: the paper's experiments."""

from __future__ import annotations

import click

from miniloop_cli.cli.bench.factory import command
from miniloop_cli.cli.bench.table import PAPER
from miniloop_cli.cli.main import CONTEXT, LazyGroup


@click.group(
    cls=LazyGroup,
    commands=[command(benchmark) for benchmark in PAPER],
    context_settings=CONTEXT,
    short_help="The paper's experiments.",
)
def bench() -> None:
    """The paper's experiments; each writes rows (CSV, JSON) and a picture.

    \b
    Example:   miniloop bench solvers --json -
    """
