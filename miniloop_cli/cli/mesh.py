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
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE|DIR",
              help="A .glb, .obj or .ply file, or a folder [default: DIR].")  # fmt: skip
@click.option("--texture/--no-texture", default=None,
              help="Colours from the sharpest images, not one a vertex [default: for .glb and .obj].")  # fmt: skip
@click.option("--texture-size", type=click.IntRange(256, 16384), default=8192, show_default=True, metavar="PX",
              help="Largest width and height of the texture.")  # fmt: skip
@click.option("--min-piece", type=click.FloatRange(0), default=0.2, show_default=True, metavar="METRES",
              help="Separate pieces smaller than this are left out.")  # fmt: skip
@click.option("--keep-unseen", is_flag=True,
              help="With a texture, also keep surfaces that are hidden in all images used.")  # fmt: skip
@click.option("--watertight", is_flag=True, help="Close all holes, with surface that no scan has seen.")
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
    texture: bool | None,
    texture_size: int,
    min_piece: float,
    keep_unseen: bool,
    watertight: bool,
    voxel: float,
    max_depth: float,
    min_weight: float,
    memory: int,
    quiet: bool,
) -> None:
    """Fuse the scans of the result in DIR (default: the newest) into one surface.

    In a folder, mesh.ply and fused_cloud.ply are written. In a GLB file, y is up.

    \b
    Example:   miniloop mesh results/desk -o desk.glb
    """
    from miniloop_cli.export.make_mesh import Wishes, make_mesh
    from miniloop_cli.export.mesh_file import write_mesh
    from miniloop_cli.geometry.upward import to_y_up
    from miniloop_cli.results.ply import write_ply

    path = mesh_path(output)
    model = open_model(result, sequence, layout, camera, follow_links)
    if texture is None:
        texture = path is not None and path.suffix.lower() != ".ply"
    wishes = Wishes(voxel, max_depth, memory, min_weight, min_piece, texture, texture_size, keep_unseen, watertight)
    made = make_mesh(model, wishes, quiet)
    folder = output or model.results.root
    T_up_world = to_y_up(model.trajectory.T_world_cam, model.results.leveled)
    written = write_mesh(path or folder / "mesh.ply", made.mesh, T_up_world)
    if not quiet:
        for said in made.notes:
            click.echo(said, err=True)
    click.echo(f"{written[0]}  {len(made.mesh.vertices)} vertices, {len(made.mesh.triangles)} triangles")
    if made.mesh.texture:
        height, width = made.mesh.texture.image.shape[:2]
        click.echo(f"{written[-1]}  texture of {width} x {height} pixels")
    if path is None:
        write_ply(folder / "fused_cloud.ply", made.surface.points, made.surface.point_colors)
        click.echo(f"{folder / 'fused_cloud.ply'}  {len(made.surface.points)} points")


def mesh_path(output: Path | None) -> Path | None:
    """The file that `-o` names; None for a folder. Raises UsageError for an unsupported format."""
    from miniloop_cli.export.mesh_file import OTHER_SUFFIXES, SUFFIXES

    if output is None or output.is_dir():
        return None
    suffix = output.suffix.lower()
    if suffix in OTHER_SUFFIXES:
        raise click.UsageError(f"{suffix} is not written; name a file with {', '.join(SUFFIXES)}, or a folder")
    if suffix not in SUFFIXES and output.exists():
        raise click.UsageError(f"{output} is a file; name one with {', '.join(SUFFIXES)}, or a folder")
    return output if suffix in SUFFIXES else None
