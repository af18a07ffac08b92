"""`miniloop export`: a result in the formats of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT

if TYPE_CHECKING:
    from miniloop_cli.export.model import Model

# Format: the function that writes it, and its description.
FORMATS = {
    "tum": ("plain:write_tum", "trajectory.txt: timestamp tx ty tz qx qy qz qw"),
    "kitti": ("plain:write_kitti", "poses.txt (3 x 4 matrices) and times.txt"),
    "g2o": ("plain:write_graph", "graph.g2o: poses, edges and their information"),
    "open3d": ("open3d_json:write_open3d", "pose_graph.json, camera_trajectory.json"),
    "colmap": ("colmap:write_colmap", "undistorted images, model (text and binary), depth maps, masks"),
    "nerfstudio": ("nerfstudio:write_nerfstudio", "transforms.json with depth, cloud.ply"),
    "numpy": ("plain:write_numpy", "poses.npz"),
    "ply": ("plain:write_clouds", "cameras.ply and cloud.ply"),
}

recording = click.option(
    "--sequence",
    type=click.Path(exists=True, path_type=Path),
    metavar="SEQ",
    help="The recording that was registered [default: its folder during the run].",
)
camera = options.camera("Camera file of SEQ (YAML, or of another program) [default: the camera of the run].")


@click.command(
    context_settings=CONTEXT,
    short_help="A result in the format of another tool.",
    epilog="\b\n" + "\n".join(f"{k:<11} {v[1]}" for k, v in FORMATS.items()),
)
@click.argument(
    "result", metavar="[DIR]", required=False, type=click.Path(file_okay=False, exists=True, path_type=Path)
)
@click.option(
    "--to", "formats", required=True, multiple=True, type=click.Choice(list(FORMATS)), help="May be repeated."
)
@click.option(
    "-o", "--output", type=click.Path(file_okay=False, path_type=Path), help="Output folder [default: DIR/<format>]."
)
@recording
@options.layout
@options.follow_links
@camera
@options.quiet
def export(
    result: Path | None,
    formats: tuple[str, ...],
    output: Path | None,
    sequence: Path | None,
    layout: str | None,
    follow_links: bool,
    camera: Path | None,
    quiet: bool,
) -> None:
    """Write the result in DIR (default: the newest) in the format of another tool.

    \b
    Example:   miniloop export results/desk --to colmap --to tum
    """
    import importlib

    model = open_model(result, sequence, layout, camera, follow_links)
    for name in formats:
        module, function = FORMATS[name][0].split(":")
        write = getattr(importlib.import_module(f"miniloop_cli.export.{module}"), function)
        target = output / name if output and len(formats) > 1 else output or model.results.root / name
        for path in write(model, target):
            if not quiet:
                click.echo(path)


def open_model(
    result: Path | None, sequence: Path | None, layout: str | None, camera: Path | None, follow_links: bool = False
) -> Model:
    """The results folder, the newest by default, with the recording: the given one, else that of the run.

    The camera is that of the run, unless another one is given.
    """
    from miniloop_cli.datasets import open_sequence
    from miniloop_cli.export.model import Model
    from miniloop_cli.results.folder import Results, newest_result
    from miniloop_cli.results.recording import reopened

    results = Results(result or newest_result())
    if camera is None and results.camera:
        camera = results.root / "camera.yaml"
    if sequence:
        return Model(results, open_sequence(sequence, layout, camera, follow_links=follow_links))
    found, problem = reopened(results, layout, camera, follow_links)
    return Model(results, found, problem)  # a format that needs it raises an error without it
