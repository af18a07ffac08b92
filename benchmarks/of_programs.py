"""Trajectories of whole programs beside each other, as `python -m benchmarks` offers them."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli.bench.factory import Benchmark, Column, numbers
from miniloop_cli.cli.bench.table import SEQUENCES

FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)
FILE = click.Path(exists=True, dir_okay=False, path_type=Path)

EPIPOLAR = Benchmark(
    "epipolar",
    "Trajectories judged by the images alone.",
    """Median distance (px) of matches from the epipolar lines of the relative poses, for frames 1 to 50 apart.

    RECORDING: with or without ground truth. Features and matches are OpenCV's; depth takes no part. A result is judged
    with its own camera, ground truth and other trajectories with that of the first result. Their poses are taken for
    those of the colour camera and, if the result names a depth camera, for those of that as well.

    \b
    Example:   python -m benchmarks epipolar path/to/recording --result results/recording
    """,
    rows="benchmarks.experiments.epipolar:epipolar_rows",
    draw="benchmarks.experiments.epipolar:draw",
    heading="{sequence}, frames {apart} apart",
    columns=(
        Column("trajectory", "{trajectory}", "<28"),
        Column("poses of", "{poses_of}", "<9"),
        *numbers(">8", ".2f", "px", "pairs"),
    ),
    options=(
        click.argument("folder", metavar="RECORDING", type=FOLDER),
        click.option(
            "--result", "results", type=FOLDER, multiple=True, required=True, help="A results folder; may be repeated."
        ),
        click.option(
            "--trajectory",
            "others",
            type=FILE,
            multiple=True,
            help="Another program's trajectory; may be repeated.",
        ),
    ),
)

WHOLE = Benchmark(
    "whole",
    "Whole recordings, beside other systems.",
    """Every frame of a recording: poses, errors against ground truth, what it took.

    SEQ: recordings with ground truth. ATE over all poses, after SE(3) alignment on positions; frame deg and cm: mean
    relative errors of frames that follow each other in the recording; ground truth is the nearest sample within
    20 ms. Seconds and memory are those of the whole process and of all that it starts, from image files to
    trajectory. ORB-SLAM3 runs in its RGB-D mode, with the recording's camera and a vocabulary learned beforehand from
    the recording's own features. Open3D's reconstruction system runs with its default settings on undistorted images,
    by the programs in examples/python/reconstruction_system of its sources.

    \b
    Needs:     pip install pyorbslam3
               Debian: libgl1 libegl1 libopengl0 libsm6 libice6 libx11-6 libxext6
    Example:   python -m benchmarks whole path/to/freiburg1_desk --program miniloop --program orbslam3
    """,
    rows="benchmarks.experiments.whole:whole_rows",
    draw="benchmarks.experiments.whole:draw",
    heading="{sequence}",
    columns=(
        Column("", "{program}", "<33"),
        Column("poses", "{poses} of {frames}", ">14"),
        *numbers(">10", ".2f", ate_cm="ATE cm", rpe_deg="frame deg", rpe_cm="frame cm"),
        *numbers(">9", ".1f", cpu_s="CPU s", wall_s="wall s"),
        *numbers(">9", ".0f", peak_mb="peak MB"),
        Column("", "  {said}", ""),
    ),
    options=(
        SEQUENCES,
        click.option(
            "--program",
            "programs",
            multiple=True,
            type=click.Choice(["miniloop", "orbslam3", "orbslam3-waits", "open3d"]),
            help="Only this program; may be repeated [default: all; open3d with --open3d].",
        ),
        click.option(
            "--open3d",
            type=FOLDER,
            help="Folder with the programs of Open3D's reconstruction system.",
        ),
        click.option(
            "--runs",
            type=click.Path(file_okay=False, path_type=Path),
            default=Path("results/whole"),
            show_default=True,
            help="Where the programs leave their results.",
        ),
    ),
    parallel=False,
)

OF_PROGRAMS = (EPIPOLAR, WHOLE)
