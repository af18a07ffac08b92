"""`miniloop eval`: a trajectory against its ground truth."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT

# The names in geometry.conventions, repeated here as importing it imports numpy.
CONVENTIONS = [
    *("camera-to-world", "world-to-camera", "opengl", "opengl-world-to-camera"),
    *("w-first", "w-first-world-to-camera", "left-handed", "body"),
]
RPE_TITLES = {"edges": "graph edges", "consecutive": "consecutive", "seconds": "one second"}


@click.command(name="eval", context_settings=CONTEXT, short_help="Errors of a result against its ground truth.")
@click.argument("result", required=False, type=click.Path(exists=True, path_type=Path))
@click.option(
    "--gt",
    required=True,
    type=click.Path(exists=True, path_type=Path),
    help="Ground truth: a trajectory (TUM, KITTI, EuRoC ...), or a recording that has one.",
)
@click.option(
    "--gt-convention",
    "convention",
    type=click.Choice(CONVENTIONS),
    default=CONVENTIONS[0],
    show_default=True,
    metavar="NAME",
    help=f"Convention of its poses: {', '.join(CONVENTIONS[:-1])}; or body (fixed to the camera, offset fitted).",
)
@click.option(
    "--edges",
    "edges_path",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Edges of the relative errors: lines 'i j' of frame numbers [default: the result's edges.csv].",
)
@click.option(
    "--association",
    type=click.Choice(["interpolate", "nearest"]),
    default="interpolate",
    show_default=True,
    help="How ground truth is found for a frame's stamp; evo and the TUM scripts use nearest.",
)
@click.option(
    "--max-diff",
    type=click.FloatRange(min=0),
    default=0.02,
    show_default=True,
    metavar="SECONDS",
    help="Largest time between a frame and a single ground-truth sample.",
)
@click.option(
    "--max-gap",
    type=click.FloatRange(min=0),
    default=0.1,
    show_default=True,
    metavar="SECONDS",
    help="interpolate: the two samples around a frame may be this far apart.",
)
@click.option("--scale", is_flag=True, help="Align with a free scale (Sim3) instead of a rigid motion.")
@options.follow_links
@options.json_file
@click.option(
    "--plot",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Write trajectory.png and errors.png into DIR.",
)
@options.quiet
def evaluate(
    result: Path | None,
    gt: Path,
    convention: str,
    edges_path: Path | None,
    association: str,
    max_diff: float,
    max_gap: float,
    scale: bool,
    follow_links: bool,
    json_path: str | None,
    plot: Path | None,
    quiet: bool,
) -> None:
    """Absolute and relative errors of RESULT (a results folder or a trajectory; default: the newest result).

    \b
    Example:   miniloop eval results/desk --gt data/freiburg1_desk --plot results/desk
    """
    from miniloop_cli import api
    from miniloop_cli.evaluation.evaluate import Protocol
    from miniloop_cli.results.folder import newest_result

    source = result or newest_result()
    protocol = Protocol("Sim3" if scale else "SE3", association, max_diff, max_gap, convention=convention)
    evaluation = api.evaluate(source, gt, edges=edges_path, protocol=protocol, follow_links=follow_links)
    if json_path != "-":
        click.echo(table(evaluation.numbers, str(source), protocol.describe()))
    if json_path:
        options.write_json(json_path, {"trajectory": str(source), "ground_truth": str(gt)} | evaluation.numbers)
    if plot:
        from miniloop_cli.evaluation.plots import write_plots

        for path in write_plots(evaluation, plot):
            if not quiet:
                click.echo(f"wrote {path}", err=True)


def table(numbers: dict[str, Any], source: str, association: str) -> str:
    """The numbers as a table of at most 80 columns, with the protocol beside them."""
    alignment = numbers["protocol"]["alignment"]
    scale = f", scale {numbers['scale']:.5f}" if alignment == "Sim3" else ""
    lines = [
        source,
        f"{numbers['poses_with_ground_truth']} of {numbers['poses']} poses have ground truth",
        association,
        *textwrap.wrap(f"ground truth: {numbers['protocol']['ground_truth']}", 80, subsequent_indent="  "),
        "",
        f"{'ATE':<14}{'rmse':>9}{'mean':>9}{'median':>9}{'max':>9}   {alignment}-aligned positions{scale}",
        f"{'cm':<14}" + "".join(f"{100 * numbers[f'ate_{key}_m']:9.3f}" for key in ("rmse", "mean", "median", "max")),
        "",
        f"{'relative':<14}{'mean':>9}{'median':>9}{'mean':>9}{'median':>9}   pairs",
        f"{'':<14}{'deg':>9}{'deg':>9}{'cm':>9}{'cm':>9}",
    ]
    for name, title in RPE_TITLES.items():
        row = numbers["rpe"][name]
        if not row["pairs"]:
            lines.append(f"{title:<14}{'-':>9}{'-':>9}{'-':>9}{'-':>9}   none")
            continue
        values = [row["rot_deg_mean"], row["rot_deg_median"], 100 * row["trans_m_mean"], 100 * row["trans_m_median"]]
        lines.append(
            f"{title:<14}" + "".join(f"{v:9.3f}" for v in values) + f"   {row['pairs']} ({row['protocol']['delta']})"
        )
    return "\n".join(lines)
