"""`miniloop mesh`: one surface from all registered scans."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.export import camera, open_model, recording
from miniloop_cli.cli.main import CONTEXT


@click.command(context_settings=CONTEXT, short_help="One coloured surface from all scans.")
@click.argument(
    "result", metavar="[DIR]", required=False, type=click.Path(file_okay=False, exists=True, path_type=Path)
)
@recording
@options.layout
@options.follow_links
@camera
@options.output_dir("DIR")
@click.option("--voxel", type=click.FloatRange(0.001, 1), default=0.01, show_default=True, metavar="METRES",
              help="Voxel size; detail below it is lost.")  # fmt: skip
@click.option("--max-depth", type=click.FloatRange(0.1), default=4.0, show_default=True, metavar="METRES",
              help="Depth readings beyond this are not used.")  # fmt: skip
@click.option("--min-weight", type=click.FloatRange(0), default=3.0, show_default=True, metavar="N",
              help="Surfaces seen fewer times are left out.")  # fmt: skip
@click.option("--memory", type=click.IntRange(50), default=3000, show_default=True, metavar="MB",
              help="Memory limit; if it does not suffice, larger voxels are used.")  # fmt: skip
@options.quiet
def mesh(
    result: Path | None,
    sequence: Path | None,
    layout: str | None,
    follow_links: bool,
    camera: Path | None,
    output: Path | None,
    voxel: float,
    max_depth: float,
    min_weight: float,
    memory: int,
    quiet: bool,
) -> None:
    """Fuse the scans of the result in DIR (default: the newest) to mesh.ply and fused_cloud.ply.

    \b
    Example:   miniloop mesh results/desk --voxel 0.02
    """
    from miniloop_cli.export.mesh import fuse
    from miniloop_cli.results.ply import write_ply

    model = open_model(result, sequence, layout, camera, follow_links)
    surface = fuse(model, voxel, max_depth, memory, min_weight, quiet)
    target = output or model.results.root
    write_ply(target / "mesh.ply", surface.vertices, surface.colors, surface.triangles)
    write_ply(target / "fused_cloud.ply", surface.points, surface.point_colors)
    if not quiet:
        for reason in surface.skipped:
            click.echo(f"skipped {reason}", err=True)
        if surface.voxel_m > voxel:
            click.echo(f"voxels of {1000 * surface.voxel_m:.0f} mm, to stay within {memory} MB", err=True)
    click.echo(f"{target / 'mesh.ply'}  {len(surface.vertices)} vertices, {len(surface.triangles)} triangles")
    click.echo(f"{target / 'fused_cloud.ply'}  {len(surface.points)} points")
