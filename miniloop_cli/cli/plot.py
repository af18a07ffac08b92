"""`miniloop plot`: a figure of one or more results for a paper."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT


@click.command(context_settings=CONTEXT, short_help="A figure of one or more results for a paper.")
@click.argument("results", metavar="[RESULT]...", nargs=-1, type=click.Path(exists=True, path_type=Path))
@click.option(
    "--gt",
    type=click.Path(exists=True, path_type=Path),
    help="Ground truth: a trajectory, or a recording that has one. Without it the first result is the reference.",
)
@click.option("--scale", is_flag=True, help="Align with a free scale (Sim3) instead of a rigid motion.")
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="A .pdf, .svg or .png file; may be repeated [default: plot.pdf].",
)
@click.option(
    "--width", type=click.FloatRange(2, 30), default=7.0, show_default=True, metavar="INCHES", help="Of the figure."
)
@options.follow_links
def plot(
    results: tuple[Path, ...],
    gt: Path | None,
    scale: bool,
    outputs: tuple[Path, ...],
    width: float,
    follow_links: bool,
) -> None:
    """Paths from above and from the side, errors over time and their histogram, of each RESULT (default: the newest).

    A RESULT is a results folder or a trajectory of another program. The colours are distinct for colour-blind readers.

    \b
    Example:   miniloop plot results/desk orbslam.txt --gt data/freiburg1_desk -o desk.pdf
    """
    from miniloop_cli.evaluation.figure import FORMATS, paper_figure, save_figure
    from miniloop_cli.results.figure_inputs import figure_lines
    from miniloop_cli.results.folder import newest_result

    paths = outputs or (Path("plot.pdf"),)
    for path in paths:
        if path.suffix.lower().removeprefix(".") not in FORMATS:
            raise click.UsageError(f"{path} must end in .{', .'.join(FORMATS)}")
    lines, truth, panel = figure_lines(list(results) or [newest_result()], gt, scale, follow_links)
    figure = paper_figure(lines, truth, panel, width)
    for path in paths:
        click.echo(save_figure(figure, path))
