"""`miniloop view`: a result or a model in the browser, served on this machine only."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.export import camera, open_model, recording
from miniloop_cli.cli.main import CONTEXT

if TYPE_CHECKING:
    from miniloop_cli.report.viewer.shown import Shown

MODELS = (".ply", ".glb")


@click.command(context_settings=CONTEXT, short_help="A result or a model in the browser, in 3D.")
@click.argument("shown", metavar="[DIR|PLY|GLB]", required=False, type=click.Path(exists=True, path_type=Path))
@recording
@options.layout
@options.follow_links
@camera
@click.option(
    "--up",
    type=click.Choice(["x", "-x", "y", "-y", "z", "-z"]),
    help="Which axis of a PLY or GLB file points up [default: z, in GLB y].",
)
@click.option("--no-open", is_flag=True, help="Print the address without opening it.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, metavar="N", help="Port [default: any that is free].")
@options.quiet
def view(
    shown: Path | None,
    sequence: Path | None,
    layout: str | None,
    follow_links: bool,
    camera: Path | None,
    up: str | None,
    no_open: bool,
    port: int,
    quiet: bool,
) -> None:
    """Show a result (default: the newest), a map, a PLY cloud or mesh, or a GLB file in the browser, until Ctrl-C.

    A PLY file in a results folder is shown with the cameras of that result. The page is served on 127.0.0.1
    only, and its address contains a token. Other computers and other pages cannot read it.

    \b
    Example:   miniloop view results/desk
    """
    from miniloop_cli.report.viewer.server import ViewServer

    server = ViewServer(_what(shown, sequence, layout, camera, follow_links, up, quiet), port)
    try:
        click.echo(server.address)
        if not no_open:
            import webbrowser

            if not webbrowser.open(server.address) and not quiet:
                click.echo("no browser could be opened: open the address yourself", err=True)
        if not quiet:
            click.echo("Ctrl-C ends it", err=True)
        server.serve_forever()
    finally:
        server.server_close()


def _what(
    shown: Path | None,
    sequence: Path | None,
    layout: str | None,
    camera: Path | None,
    follow_links: bool,
    up: str | None,
    quiet: bool,
) -> Shown:
    """A result, with its recording if that can be opened, or a model. Raises InputError."""
    from miniloop_cli.errors import InputError
    from miniloop_cli.report.viewer.map_scene import load_map
    from miniloop_cli.report.viewer.shown import show_map, show_model, show_result
    from miniloop_cli.results.columns import load
    from miniloop_cli.results.map_folder import has_map, read_manifest, read_map

    model = None
    if shown and shown.is_file():
        if shown.suffix.lower() not in MODELS:
            raise InputError(f"{shown} is neither a results folder nor a .ply or .glb file")
        of_a_result = shown.suffix.lower() == ".ply" and (shown.parent / "trajectory.txt").is_file() and up is None
        if not of_a_result:
            return show_model(shown, up)
        shown, model = shown.parent, shown
    if shown and has_map(shown) and len(read_manifest(shown)["recordings"]) > 1:
        return show_map(load_map(shown, read_map(shown)), shown)
    opened = open_model(shown, sequence, layout, camera, follow_links)
    if opened.problem and not quiet:
        click.echo(f"shown without images: {opened.problem}", err=True)
    return show_result(load(opened.results.root, opened.sequence), model)
