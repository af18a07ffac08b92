"""`miniloop demo`: simulate, register, evaluate; the first command for new users."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT


@click.command(context_settings=CONTEXT, short_help="Simulate a recording, register it, measure the error.")
@options.output_dir("demo")
@click.option(
    "--frames", type=click.IntRange(min=3), default=30, show_default=True, metavar="N", help="Frames to simulate."
)
@options.jobs
@options.seed
@options.quiet
@options.verbose
def demo(output: Path | None, frames: int, jobs: int, seed: int, quiet: bool) -> None:
    """Simulate a small recording, register it, and measure the result: no download, about a minute.

    \b
    Example:   miniloop demo
    """
    from miniloop_cli.cli.eval import evaluate
    from miniloop_cli.cli.register import register
    from miniloop_cli.cli.simulate import simulate
    from miniloop_cli.warmup import compile_in_background

    folder = output or Path("demo")
    recording, result = folder / "recording", folder / "result"
    if jobs != 1:
        compile_in_background()
    context = click.get_current_context()
    context.invoke(simulate, folder=recording, frames=frames, seed=seed, quiet=quiet, overwrite=True)
    context.invoke(register, sequences=(recording,), output=result, jobs=jobs, seed=seed, quiet=quiet)
    context.invoke(evaluate, result=result, gt=recording, plot=result)
