"""`miniloop simulate DIR`: a synthetic RGB-D recording with exact ground truth."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT

SCENES = ("room", "two-rooms", "plane", "textureless", "repeated", "turntable")
ALIKE = ("nothing", "half-turn", "rooms", "furniture")
PATHS = ("loop", "xyz", "rotation", "still", "random-walk")
HARD = ("blank", "dark", "blur", "covered", "doubled", "frozen", "swapped", "unsorted", "broken", "missing")


@click.command(context_settings=CONTEXT, short_help="A synthetic recording with exact ground truth.")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--frames", type=click.IntRange(min=1), default=30, show_default=True, metavar="N", help="Number of frames."
)
@click.option("--width", type=int, default=640, show_default=True, help="Width of the images (px).")
@click.option("--height", type=int, default=480, show_default=True, help="Height of the images (px).")
@click.option("--scene", type=click.Choice(SCENES), default="room", show_default=True, help="What is recorded.")
@click.option("--path", type=click.Choice(PATHS), default="loop", show_default=True, help="How the camera moves.")
@click.option("--rooms", type=int, default=1, show_default=True, help="Rooms joined by doors, walked through and back.")
@click.option(
    "--hard", multiple=True, type=click.Choice((*HARD, "all")), help="Add a stretch with this fault; may be repeated."
)
@click.option(
    "--alike", type=click.Choice(ALIKE), default="nothing", show_default=True, help="Add places that look the same."
)
@click.option(
    "--cuts", type=int, default=0, show_default=True, help="Number of jumps of the path without a gap in the stamps."
)
@click.option("--noise/--no-noise", default=True, show_default=True, help="Noise, steps and holes of a Kinect.")
@click.option("--noise-level", type=float, default=1.0, show_default=True, help="Noise as a multiple of a Kinect's.")
@click.option("--moving-object", is_flag=True, help="A figure walks in front of the camera.")
@click.option("--masks", is_flag=True, help="Also write mask/ with the pixels of the figure.")
@click.option("--depth-limit", type=float, default=5.0, show_default=True, help="Largest depth (m).")
@click.option("--exposure", type=float, default=1.0, show_default=True, help="Gain of the image; 3 is over-exposed.")
@click.option("--blur", type=float, default=0.0, show_default=True, help="Exposure time, for motion blur (s).")
@click.option(
    "--rolling-shutter", type=float, default=0.0, show_default=True, help="Readout time from first to last row (s)."
)
@click.option("--rate", type=float, default=10.0, show_default=True, help="Frames a second.")
@click.option("--path-share", type=float, default=1.0, show_default=True, help="Share of the path that is walked.")
@click.option("--focal", type=float, metavar="PX", help="Focal length [default: 525 px at a width of 640].")
@click.option(
    "--depth-baseline",
    type=float,
    default=0.0,
    show_default=True,
    help="Distance of the depth camera to the left of colour (m).",
)
@click.option(
    "--depth-turn", type=float, default=0.0, show_default=True, help="Rotation of the depth camera (degrees)."
)
@click.option("--depth-focal", type=float, metavar="PX", help="Focal length of depth [default: that of colour].")
@click.option("--accelerometer", is_flag=True, help="Also write accelerometer.txt (m/s^2, camera axes, noisy).")
@click.option("--overwrite", is_flag=True, help="Replace a folder that was simulated before.")
@options.seed
@options.quiet
def simulate(
    folder: Path,
    frames: int,
    width: int,
    height: int,
    scene: str,
    path: str,
    rooms: int,
    hard: tuple[str, ...],
    alike: str,
    cuts: int,
    noise: bool,
    noise_level: float,
    moving_object: bool,
    masks: bool,
    depth_limit: float,
    exposure: float,
    blur: float,
    rolling_shutter: float,
    rate: float,
    path_share: float,
    focal: float | None,
    depth_baseline: float,
    depth_turn: float,
    depth_focal: float | None,
    accelerometer: bool,
    overwrite: bool,
    seed: int,
    quiet: bool,
) -> None:
    """Write a synthetic RGB-D recording with exact ground truth to DIR, in TUM's layout.

    The scene is a furnished, textured room, seen by a Kinect-like camera. The same options and seed give the same
    bytes. The frames are spread over the whole path. With --depth-baseline, --depth-turn or --depth-focal, depth has a
    separate camera, which camera.yaml describes. --hard adds stretches with faults, in the given order; stretches.csv
    lists their frames.

    \b
    Example:   miniloop simulate room && miniloop register room
    """
    from miniloop_cli import api
    from miniloop_cli.runtime.progress import track

    done = api.simulate(
        folder,
        seed=seed,
        overwrite=overwrite,
        progress=lambda items: track(items, "simulating", total=frames, quiet=quiet),
        frames=frames,
        width=width,
        height=height,
        scene=scene,
        path=path,
        rooms=rooms,
        hard=tuple(name for given in hard for name in (HARD if given == "all" else (given,))),
        alike=alike,
        cuts=cuts,
        noise=noise,
        noise_level=noise_level,
        moving_object=moving_object,
        masks=masks,
        depth_limit_m=depth_limit,
        exposure=exposure,
        blur_s=blur,
        rolling_shutter_s=rolling_shutter,
        rate_hz=rate,
        path_share=path_share,
        focal_px=focal,
        depth_baseline_m=depth_baseline,
        depth_turn_deg=depth_turn,
        depth_focal_px=depth_focal,
        accelerometer=accelerometer,
    )
    if not quiet:
        click.echo(f"{frames} frames with ground truth in {done}; next: miniloop register {folder}", err=True)
