"""Measurements on simulations, whose truth is known, as `python -m benchmarks` offers them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from miniloop_cli.cli.bench.factory import Benchmark, Column, numbers, several, whole

SIGMA = click.FloatRange(min=0)


class Share(click.ParamType):
    """A share of the edges, 0.05 or, in percent, 5; below all of them."""

    name = "share"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The share as a number below 1."""
        given = click.FLOAT.convert(value, param, ctx)
        share = given / 100 if given >= 1 else given
        if not 0 <= share < 1:
            self.fail("a share of the edges (0.05) or percent (5), below all of them", param, ctx)
        return share


AVERAGING = Benchmark(
    "averaging",
    "Motion averaging on graphs with known poses.",
    """Rotation and translation averaging on graphs with known poses: time, error, memory.

    Options that name a graph can be given several times; every combination is measured.

    \b
    Example:   python -m benchmarks averaging --scans 10000 --edges 50000 --outliers 0.1 --kind expander
    """,
    rows="benchmarks.experiments.averaging:averaging_rows",
    draw="benchmarks.experiments.averaging:draw",
    columns=numbers(
        ">12",
        ".4g",
        "method",
        "kind",
        "scans",
        "edges",
        "outliers",
        "seconds",
        cpu_seconds="CPU s",
        rotation_seconds="rotation s",
        rot_err_deg_median="median deg",
        rot_err_deg_mean="mean deg",
        trans_err_median="median m",
        peak_mb="peak MB",
        converged="converged",
        proof_cpu_seconds="proof CPU s",
        certified="certified",
    ),
    options=(
        several("--scans", click.IntRange(min=2), (100, 1000, 10_000), "Scans of a graph."),
        click.option("--edges", type=click.IntRange(min=1), help="Edges of each graph [default: 5 a scan]."),
        several("--outliers", Share(), (0.05,), "Share of edges with a random relative pose (0.05), or percent (5)."),
        several("--kind", click.Choice(["video", "expander"]), ("video",), "How scans are connected."),
        click.option("--noise-deg", type=SIGMA, default=0.5, show_default=True, help="Along each axis."),
        click.option("--noise-m", type=SIGMA, default=0.01, show_default=True, help="Along each axis."),
        click.option("--certificate", is_flag=True, help="Also prove the optimum of the true edges."),
        click.option("--peers", is_flag=True, help="Also pycolmap and, up to 1000 scans, gtsam, where installed."),
    ),
)

CALIBRATION = Benchmark(
    "calibration",
    "Errors in units of what is promised.",
    """The share of pose errors within two of their own standard deviations, over paths, noise and numbers of frames.

    Every error is one of six of a pose (rotation and translation along its camera's axes), relative to the frame that
    the run holds fixed. 95.4 % if everything were Gaussian.

    \b
    Example:   python -m benchmarks calibration --seeds 5 --noise 1 --frames 30
    """,
    rows="benchmarks.experiments.calibration:calibration_rows",
    draw="benchmarks.experiments.calibration:draw",
    columns=(
        Column("path", "{path}", "<13"),
        Column("noise", "{noise:g}", ">6"),
        *numbers(">7", "", "frames", "poses"),
        Column("2 sigma", "{within_2_sigma:.0%}", ">9"),
        *numbers(">10", ".3f", error_cm_rms="error cm", promised_cm_rms="promised"),
    ),
    options=(
        several("--frames", click.IntRange(min=3), (16, 32), "Frames of a recording."),
        several("--noise", SIGMA, (0.5, 1.0, 2.0), "Times a Kinect's."),
        whole("--seeds", 1, 2, "Recordings of each kind."),
        whole("--width", 160, 320, "Width of the images (px)."),
    ),
)

SCENES = Benchmark(
    "scenes",
    "Hard scenes: right poses, or an honest no.",
    """Simulated scenes, each with a stated right answer: frames registered, error, what is said of the others.

    The error is the rmse of positions after one rigid motion that fits orientations and positions; 2 sigma: the share
    of the errors, axis by axis, within twice the standard deviation that the run promises.

    \b
    Example:   python -m benchmarks scenes --only "repeated texture" --seeds 5
    """,
    rows="benchmarks.experiments.scenes:scene_rows",
    draw="benchmarks.experiments.scenes:draw",
    columns=(
        Column("scene", "{scene}", "<31"),
        Column("registered", "{registered} of {frames}", ">12"),
        Column("error cm", "{ate_cm:.2f}", ">10"),
        Column("2 sigma", "{within_2_sigma:.0%}", ">9"),
        Column("right", "{as_expected}", ">7"),
        Column("  what is said", "  {verdict}", ""),
    ),
    options=(
        click.option("--only", multiple=True, metavar="SCENE", help="Only this scene; may be repeated."),
        whole("--frames", 4, 30, "Frames a scene."),
        whole("--width", 160, 640, "Width of the images (px)."),
        whole("--seeds", 1, 1, "Rooms and paths a scene."),
    ),
)

CERTAINTY = Benchmark(
    "certainty",
    "How often 'it worked' is wrong.",
    """Simulated recordings of places that look alike, turntables and jumps: what is said of the result, and how many
    frames stand elsewhere than it says (by more than 8 degrees or 20 cm, as most others have it).

    \b
    Example:   python -m benchmarks certainty --only "turntable, alike from behind" --seeds 10
    """,
    rows="benchmarks.experiments.certainty:certainty_rows",
    draw="benchmarks.experiments.certainty:draw",
    columns=(
        Column("case", "{case}", "<30"),
        Column("seed", "{seed}", ">5"),
        Column("registered", "{registered} of {frames}", ">12"),
        Column("elsewhere", "{elsewhere}", ">10"),
        Column("  outcome", "  {outcome}", ""),
    ),
    options=(
        click.option("--only", multiple=True, metavar="CASE", help="Only this case; may be repeated."),
        whole("--width", 160, 240, "Width of the images (px)."),
        whole("--seeds", 1, 5, "Recordings of each case."),
    ),
)

GROWTH = Benchmark(
    "growth",
    "Time, memory and loops of ever longer recordings.",
    """Simulated recordings at 30 Hz, through as many rooms as fit, and back: what registering takes for each frame.

    Loops: pairs of frames a second apart that see the same place, 40 % of each other's view, at least 15 s later;
    found, those that a verified edge joins, within a second of both. Between rooms: those seen through a door.
    Recordings are kept and used again.

    \b
    Example:   python -m benchmarks growth --frames 1000 --frames 3000
    """,
    rows="benchmarks.experiments.growth:growth_rows",
    draw="benchmarks.experiments.growth:draw",
    columns=(
        *numbers(">8", "", "frames", "rooms", "poses"),
        *numbers(">9", ".2f", ate_cm="ATE cm"),
        *numbers(">9", ".1f", cpu_ms="CPU ms/f", wall_ms="wall ms/f"),
        *numbers(">9", ".0f", peak_mb="peak MB"),
        Column("loops", "{loops}", ">7"),
        Column("found", "{found_share:.0%}", ">7"),
        Column("between rooms", "{between}", ">15"),
        Column("found", "{between_share:.0%}", ">7"),
        Column("", "  {said}", ""),
    ),
    options=(
        several("--frames", click.IntRange(min=100), (1000, 3000, 10_000), "Frames of a recording."),
        whole("--width", 160, 320, "Width of the images (px)."),
        click.option(
            "--runs",
            type=click.Path(file_okay=False, path_type=Path),
            default=Path("results/growth"),
            show_default=True,
            help="Where recordings and results are kept.",
        ),
    ),
    parallel=False,
)

CAMERAS = Benchmark(
    "cameras",
    "Cameras from their own recordings.",
    """Simulated cameras whose errors are drawn from what is known of a guess: how often each parameter is found.

    A run is right where the error of a parameter is within three of the standard deviations that are promised.

    \b
    Example:   python -m benchmarks cameras --runs 20
    """,
    rows="benchmarks.experiments.known_cameras:camera_rows",
    draw="benchmarks.experiments.known_cameras:draw",
    columns=(
        Column("parameter", "{parameter}", "<18"),
        *numbers(">10", "", "runs", "estimated"),
        Column("3 sigma", "{within_3_sigma:.0%}", ">9"),
        Column("rms sigmas", "{rms_sigmas:.2f}", ">12"),
    ),
    options=(
        whole("--runs", 1, 100, "Simulated cameras."),
        whole("--frames", 3, 16, "Frames a recording."),
        whole("--points", 50, 1200, "Points of the scene."),
    ),
)

TWO_CAMERAS = Benchmark(
    "two-cameras",
    "Colour and depth cameras from their own recordings.",
    """Simulated rooms seen by a colour and a depth camera that are both guesses: how often each number is found.

    A run is right where the error of a number is within three of the standard deviations that are promised.

    \b
    Example:   python -m benchmarks two-cameras --runs 20
    """,
    rows="benchmarks.experiments.known_two_cameras:two_camera_rows",
    draw="benchmarks.experiments.known_cameras:draw",
    columns=CAMERAS.columns,
    options=CAMERAS.options,
)

ON_SIMULATIONS = (AVERAGING, CALIBRATION, CAMERAS, CERTAINTY, GROWTH, SCENES, TWO_CAMERAS)
