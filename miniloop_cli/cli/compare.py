"""`miniloop compare`: the differences of two results."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.export import camera, open_model, recording
from miniloop_cli.cli.main import CONTEXT


@click.command(context_settings=CONTEXT, short_help="Where two results differ: a table and a 3D view.")
@click.argument("first", metavar="DIR", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("second", metavar="OTHER", type=click.Path(exists=True, path_type=Path))
@click.option(
    "--gt",
    type=click.Path(exists=True, path_type=Path),
    help="Ground truth: a trajectory, or a recording that has one.",
)
@click.option("--scale", is_flag=True, help="Align with a free scale (Sim3), as for poses from colour alone.")
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("compare.html"),
    show_default=True,
    metavar="FILE",
    help="The page with the 3D view.",
)
@recording
@options.layout
@options.follow_links
@camera
@options.json_file
@options.quiet
def compare(
    first: Path,
    second: Path,
    gt: Path | None,
    scale: bool,
    output: Path,
    sequence: Path | None,
    layout: str | None,
    follow_links: bool,
    camera: Path | None,
    json_path: str | None,
    quiet: bool,
) -> None:
    """Compare OTHER with the result in DIR: distances of poses, edges that only one has, settings that differ.

    OTHER is a results folder, a trajectory (of ORB-SLAM, RTAB-Map and others: TUM, KITTI, EuRoC ...), the folder of a
    COLMAP model, or nerfstudio's transforms.json.

    \b
    Example:   miniloop compare results/desk results/desk-fast --gt data/freiburg1_desk
    """
    from miniloop_cli.report.comparison_page import differences, rows, write_comparison
    from miniloop_cli.results.columns import load
    from miniloop_cli.results.comparison import compare as lay_over
    from miniloop_cli.results.comparison import read_side
    from miniloop_cli.results.figure_inputs import labels
    from miniloop_cli.runtime.artifact_store import Store, default_folder

    opened = open_model(first, sequence, layout, camera, follow_links)
    shown = load(first, opened.sequence)
    names = labels([first, second])
    sides = read_side(first, names[0]), read_side(second, names[1], shown, opened.sequence)
    found = lay_over(*sides, gt, scale)
    table = rows(found)
    if json_path != "-":
        click.echo("\n".join(options.wrapped(sentence) for sentence in differences(found)))
        width = max(len(row[0]) for row in table) + 2
        for words, a, b in [("", *names), *table, *((key, str(a), str(b)) for key, a, b in found.settings)]:
            click.echo(f"{words:<{width}}{a:>18}{b:>18}")
    if json_path:
        numbers = {
            "poses": len(found.frames),
            "position_rmse_m": found.laid.numbers["ate_rmse_m"],
            "position_max_m": found.laid.numbers["ate_max_m"],
            "rotation_max_deg": float(found.angles_deg.max()),
            "scale": found.scale,
            "farthest_frames": found.farthest,
            "shared_edges": found.shared_edges,
            "only": [sorted(map(list, only)) for only in found.only],
            "settings": {key: [a, b] for key, a, b in found.settings},
            "ate_rmse_m": [error.numbers["ate_rmse_m"] if error else None for error in found.errors],
        }
        options.write_json(json_path, {"first": str(first), "second": str(second)} | numbers)
    page = write_comparison(found, shown, output, Store(default_folder()))
    if not quiet and json_path != "-":
        click.echo(page)
