"""Measurements on recordings with ground truth, as `python -m benchmarks` offers them."""

from __future__ import annotations

from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.bench.factory import Benchmark, Column, numbers, several, whole
from miniloop_cli.cli.bench.table import MAX_FRAMES, SEQUENCES


def _show_variants(ctx: click.Context, param: click.Parameter, wanted: bool) -> None:
    if wanted:
        from benchmarks.experiments.ablation import VARIANTS

        for name, variant in VARIANTS.items():
            click.echo(f"{name:<24}{variant.settings}")
        ctx.exit()


ABLATION = Benchmark(
    "ablation",
    "What each step is worth on a recording.",
    """One thing changed at a time: frames, errors against ground truth, seconds.

    SEQ: recordings with ground truth. ATE is the rmse after SE(3) alignment on positions; edge errors are means over
    one list of edges that all rows share; wrong is the share of edges whose own estimate, before averaging, is off by
    more than 5 deg or 10 cm; ground truth is the nearest sample within 20 ms. Seconds are those of all
    stages after the features, which come from the cache where they are.

    \b
    Example:   python -m benchmarks ablation path/to/freiburg1_desk --only "pairwise only" --only "pose graph"
    """,
    rows="benchmarks.experiments.ablation:ablation_rows",
    draw="benchmarks.experiments.ablation:draw",
    heading="{sequence}",
    columns=(
        Column("", "{variant}", "<24"),
        *numbers(
            ">9",
            ".2f",
            registered="frames",
            edges="edges",
            wrong_share="wrong",
            ate_cm="ATE cm",
            edge_deg="edge deg",
            edge_cm="edge cm",
            matching_s="match s",
            edges_s="edges s",
            averaging_s="aver. s",
            refinement_s="refine s",
            seconds="total s",
            cpu_s="CPU s",
        ),
    ),
    options=(
        SEQUENCES,
        click.option(
            "--edges",
            "edge_files",
            multiple=True,
            type=click.Path(exists=True, dir_okay=False, path_type=Path),
            help="Measure edge errors on these (lines 'i j'); one file a SEQ, in order"
            " [default: the default's verified].",
        ),
        click.option("--only", multiple=True, metavar="VARIANT", help="Only this variant beside the default; repeat."),
        click.option(
            "--list",
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=_show_variants,
            help="Show the variants with their settings, and do nothing else.",
        ),
    ),
)

EDGES = Benchmark(
    "edges",
    "The graph of a recording solved in pairs and cycles.",
    """Errors of the edges before averaging and after (->), mistakes among those verified, CPU seconds.

    SEQ: recordings with ground truth. All rows of a recording are measured on the same edges: those that each of them
    verified. Wrong: verified, and off by more than 5 deg or 10 cm.

    \b
    Example:   python -m benchmarks edges path/to/freiburg1_desk --longest 5
    """,
    rows="benchmarks.experiments.edges:edge_rows",
    draw="benchmarks.experiments.edges:draw_edges",
    heading="{sequence}",
    columns=(
        Column("solved in", "{edges_are}", "<17"),
        *numbers(
            ">11",
            ".3f",
            "verified",
            "wrong",
            "scored",
            **{
                f"before_{unit}_{kind}": f"{unit} {kind}"
                for unit in ("deg", "cm")
                for kind in ("mean", "median", "p95")
            },
            **{f"after_{unit}_{kind}": f"-> {kind}" for unit in ("deg", "cm") for kind in ("mean", "p95")},
            cpu_s="CPU s",
            cpu_over_pairs="x pairs",
        ),
    ),
    options=(
        SEQUENCES,
        several("--longest", click.IntRange(3, 7), (3, 4, 5), "Longest cycle beside pairs only."),
        MAX_FRAMES,
    ),
)

OUTLIERS = Benchmark(
    "outliers",
    "False edges against averaging and refinement.",
    """The share of graphs with false edges whose poses are as good as twice the error without them.

    SEQ: recordings with ground truth. The true edges are the recording's own, as estimated; 10 to 50 % false ones are
    put in, random, or in clusters that agree with each other. `miniloop` may look at the scans behind an edge, as
    `miniloop register` does; `edges only`, and the peers, may not. Placed: scans that get a pose.

    \b
    Example:   python -m benchmarks outliers path/to/freiburg1_xyz --runs 5
    """,
    rows="benchmarks.experiments.outliers:outlier_rows",
    draw="benchmarks.experiments.outliers:draw",
    heading="{sequence}: {scans} scans, {edges} true edges",
    columns=(
        Column("kind", "{kind}", "<11"),
        Column("false", "{false_share:.0%}", ">6"),
        Column("  method", "  {method}", "<24"),
        *numbers(">20", ".0%", within_share="positions within", rot_within_share="rotations within"),
        *numbers(">10", ".2f", ate_cm_median="ATE cm", rot_deg_median="deg"),
        Column("placed", "{posed_mean:.0%}", ">8"),
    ),
    options=(
        click.argument("sequences", nargs=-1, type=click.Path(exists=True, file_okay=False, path_type=Path)),
        click.option(
            "--simulated/--no-simulated", default=True, show_default=True, help="Also two simulated recordings."
        ),
        whole("--max-frames", 10, 50, "Scans a recording."),
        several("--percent", click.FloatRange(0, 90), (10, 20, 30, 40, 50), "False edges among all."),
        whole("--runs", 1, 10, "Graphs a kind and percentage."),
        click.option("--peers", is_flag=True, help="Also gtsam and pycolmap, where installed."),
    ),
)

RECALL = Benchmark(
    "recall",
    "Edges that choosing candidates loses.",
    """Compare all pairs exactly, then by sketches (auto), then only pairs that are near or look alike (retrieval).

    Kept: share of the edges verified by the first way that are verified by another; share: of its CPU seconds.

    \b
    Example:   python -m benchmarks recall path/to/freiburg1_desk
    """,
    rows="benchmarks.experiments.recall:recall_rows",
    draw="benchmarks.experiments.recall:draw_recall",
    heading="{sequence}",
    columns=numbers(
        ">15",
        "",
        "candidates",
        "verified",
        "kept",
        matching_cpu_s="matching CPU s",
        matching_share="share",
        registered="registered",
        ate_cm="ATE cm",
    ),
    options=(SEQUENCES, MAX_FRAMES, options.overrides),
)

CAMERA_PARTS = Benchmark(
    "camera-parts",
    "What each part of the camera model is worth.",
    """Recordings registered with more and more of the camera free: errors, and CPU seconds of the refinement.

    SEQ: recordings with ground truth. Each is given its own camera, then TUM's ROS default. What comes before the
    refinement is taken from the cache where it is there. Changed: held-out tracks spoke for the model.

    \b
    Example:   python -m benchmarks camera-parts path/to/freiburg1_desk_100
    """,
    rows="benchmarks.experiments.camera_parts:part_rows",
    draw="benchmarks.experiments.camera_parts:draw",
    heading="{sequence}, {camera}",
    columns=(
        Column("free", "{model}", "<22"),
        *numbers(">10", ".3f", ate_cm="ATE cm", scaled_cm="scaled"),
        Column("gain", "{gain:.4f}", ">9"),
        Column("changed", "{changed}", ">9"),
        *numbers(">9", ".1f", fx="fx px", cpu_s="CPU s"),
    ),
    options=(
        SEQUENCES,
        click.option(
            "--camera",
            "cameras",
            multiple=True,
            type=click.Choice(["own", "default"]),
            help="Only this camera; may be repeated [default: both].",
        ),
    ),
)

ON_RECORDINGS = (ABLATION, CAMERA_PARTS, EDGES, OUTLIERS, RECALL)
