"""`miniloop locate MAP IMAGE...`: the poses of images in a map."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT
from miniloop_cli.errors import InputError, MiniloopError

if TYPE_CHECKING:
    from miniloop_cli.mapping.location import Location
    from miniloop_cli.results.map import Map


@click.command(context_settings=CONTEXT, short_help="Where in a map an image was taken.")
@click.argument("folder", metavar="MAP", type=click.Path(file_okay=False, path_type=Path))
@click.argument("images", metavar="IMAGE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--depth",
    type=click.Path(path_type=Path),
    metavar="FILE|DIR",
    help="Depth of the image; of several, a folder with files of the same names.",
)
@options.camera("Camera of the images [default: that of the map for images of its size, else estimated].")
@options.json_file
@options.quiet
def locate(
    folder: Path, images: tuple[Path, ...], depth: Path | None, camera: Path | None, json_path: str | None, quiet: bool
) -> None:
    """Find each IMAGE in the map of the result in MAP: its pose, or why it is not found.

    An IMAGE is a file, a folder of images, or a recording. The exit status is 1 if no image was found.

    \b
    Example:   miniloop locate results/desk photo.jpg
    """
    from miniloop_cli.results.map import Map

    opened = Map.open(folder)
    rows, found = [], 0
    for name, location in _located(opened, images, depth, camera):
        found += not isinstance(location, InputError) and location.found
        rows.append(_row(opened, name, location))
        if not quiet and json_path != "-":
            click.echo(options.wrapped(f"{name}: {_words(rows[-1])}"))
    if json_path:
        options.write_json(json_path, {"map": str(folder), "rows": rows})
    if not found:
        raise MiniloopError(f"none of {len(rows)} images was found in {folder}")


def _located(
    opened: Map, images: tuple[Path, ...], depth: Path | None, camera_path: Path | None
) -> Iterator[tuple[str, Location | InputError]]:
    """Name and location of each image; an error if it cannot be read."""
    from miniloop_cli.datasets.camera_files import read_camera_file
    from miniloop_cli.datasets.single_images import is_recording, listed_images, read_single, recorded_images

    if depth is None and len(images) == 1 and not images[0].is_file() and is_recording(images[0]):
        camera, frames = recorded_images(images[0], camera_path)
        for name, scan in frames:
            yield name, scan if isinstance(scan, InputError) else opened.locate(scan.color, scan.depth_m, camera)
        return
    given = read_camera_file(camera_path) if camera_path else None
    for image in listed_images(images, depth):
        try:
            scale = (given or opened.content.parts[0].camera).depth_scale
            scan = read_single(image, scale)
            yield image.name, opened.locate_file(image.path, scan.color, scan.depth_m if image.depth else None, given)
        except InputError as error:
            yield image.name, error


def _row(opened: Map, name: str, location: Location | InputError) -> dict[str, Any]:
    """The values of an image for JSON."""
    if isinstance(location, InputError):
        location_row: dict[str, Any] = {"found": False, "sure": False, "reason": f"cannot be read: {location}"}
        return {"image": name} | location_row | {"T_world_cam": None, "covariance": None, "inliers": 0, "keyframes": []}
    T, covariance = location.T_world_cam, location.covariance
    return {
        "image": name,
        "found": location.found,
        "sure": location.sure,
        "reason": location.reason,
        "T_world_cam": None if T is None else T.tolist(),
        "covariance": None if covariance is None else covariance.tolist(),
        "inliers": location.inliers,
        "keyframes": [opened.keyframe_name(k) for k in location.keyframes],
        "piece": location.piece if location.found else None,
        "focal_px": location.focal_px,
    }


def _words(row: dict[str, Any]) -> str:
    """A row as a sentence for people."""
    if not row["found"]:
        return row["reason"]
    x, y, z = (line[3] for line in row["T_world_cam"][:3])
    variance = [row["covariance"][k][k] for k in range(6)]
    sigma_cm, sigma_deg = 100 * sum(variance[3:]) ** 0.5, 57.29578 * sum(variance[:3]) ** 0.5
    sure = "found" if row["sure"] else f"found, not sure ({row['reason']})"
    seen = row["keyframes"][0]
    return (
        f"{sure}: at ({x:.3f}, {y:.3f}, {z:.3f}) m, within {sigma_cm:.1f} cm and {sigma_deg:.2f} deg,"
        f" {row['inliers']} inliers, seen by {len(row['keyframes'])} keyframes (most by {seen['recording']},"
        f" frame {seen['frame']})"
    )
