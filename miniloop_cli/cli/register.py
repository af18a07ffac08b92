"""`miniloop register SEQ`: from a recording to poses, a model and the evidence."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT
from miniloop_cli.cli.summary import print_summary
from miniloop_cli.errors import MiniloopError
from miniloop_cli.feature_types import FEATURE_TYPES

LOG = logging.getLogger("miniloop")


@click.command(context_settings=CONTEXT, short_help="Poses and one model from a recording.")
@click.argument("sequences", metavar="SEQ...", nargs=-1, required=True, type=click.Path(path_type=Path))
@options.output_dir("results/<name of SEQ>")
@click.option(
    "--config",
    default="default",
    show_default=True,
    metavar="NAME|FILE",
    shell_complete=options.complete("complete_preset"),
    help="default, paper, fast, accurate, or a YAML file.",
)
@click.option("--features", type=click.Choice(list(FEATURE_TYPES)), help="Detector and descriptor.")
@click.option(
    "--pairs",
    metavar="MODE|FILE",
    help="Pairs to compare: auto, exhaustive, sequential, or a file of lines 'i j'.",
)
@options.camera()
@click.option(
    "--calibrate",
    type=click.Choice(["off", "auto", "on"]),
    help="Estimate the camera from the recording; auto (the default): if the camera is a guess.",
)
@click.option(
    "--gravity",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Accelerometer readings (timestamp ax ay az): they confirm weak edges and level the model, z up.",
)
@click.option(
    "--pose-prior",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Rough poses (TUM, KITTI, EuRoC ...): they select pairs to compare and reject wrong edges.",
)
@click.option("--init", type=click.Path(path_type=Path), hidden=True, help="Name of --pose-prior in release 0.1.")
@options.layout
@options.topics
@options.follow_links
@options.max_frames
@options.overrides
@click.option("--fresh", is_flag=True, help="Compute everything again; by default finished work is reused.")
@options.jobs
@click.option(
    "--cluster",
    metavar="ADDRESS",
    help="Dask scheduler, as tcp://scheduler:8786, to work on (needs: pip install 'miniloop[cluster]').",
)
@options.seed
@options.json_file
@click.option(
    "--strict", is_flag=True, help="Exit with status 1 if the result is doubtful or bad; it is still written."
)
@click.option(
    "--rerun",
    "recording_path",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.rrd",
    help="Also write the run for the Rerun viewer (needs: pip install 'miniloop[viz]').",
)
@options.quiet
@options.verbose
def register(
    sequences: tuple[Path, ...],
    output: Path | None,
    config: str,
    features: str | None,
    pairs: str | None,
    camera: Path | None,
    calibrate: str | None,
    gravity: Path | None,
    pose_prior: Path | None,
    init: Path | None,
    layout: str | None,
    topics: str,
    follow_links: bool,
    max_frames: int | None,
    overrides: tuple[str, ...],
    fresh: bool,
    jobs: int,
    cluster: str | None,
    seed: int,
    json_path: str | None,
    strict: bool,
    recording_path: Path | None,
    quiet: bool,
) -> None:
    """Register the scans of SEQ: poses of all frames, one model, and the evidence for them.

    Several recordings become one map, named by -o, in which each has its own folder.

    \b
    Example:   miniloop register rgbd_dataset_freiburg1_xyz
               miniloop eval --gt rgbd_dataset_freiburg1_xyz
               miniloop register kitchen hall -o office
    """
    from miniloop_cli.api import register as run_register
    from miniloop_cli.results.folder import Results
    from miniloop_cli.warmup import compile_in_background

    if recording_path:
        from miniloop_cli.report.rerun import import_rerun

        import_rerun()  # raises an error now instead of after the work

    if init and pose_prior:
        raise click.UsageError("--init is the old name of --pose-prior: give one of them")
    if init:
        LOG.warning("--init is called --pose-prior now; the old name goes with the next release")
    if features:
        overrides = (f"features.type={features}", *overrides)
    if calibrate:
        overrides = (f"calibrate={calibrate}", *overrides)
    if pairs:
        overrides = (f"matching.pairs={pairs}", *overrides)
    if jobs != 1:
        compile_in_background()
    if len(sequences) > 1:
        single = {
            "--gravity": gravity,
            "--pose-prior": pose_prior or init,
            "--cluster": cluster,
            "--rerun": recording_path,
        }
        if given := [name for name, value in single.items() if value]:
            raise click.UsageError(f"{given[0]} is for one recording; {len(sequences)} are given")
        if output is None:
            raise click.UsageError(f"{len(sequences)} recordings become one map: name its folder with -o DIR")
        chosen = {"settings": config, "overrides": overrides, "layout": layout, "topics": topics, "camera": camera}
        _register_many(
            sequences, output, json_path, strict, quiet,
            follow_links=follow_links, max_frames=max_frames, jobs=jobs, seed=seed, fresh=fresh, **chosen,
        )  # fmt: skip
        return
    run = run_register(
        sequences[0],
        output,
        settings=config,
        overrides=overrides,
        layout=layout,
        topics=topics,
        follow_links=follow_links,
        camera=camera,
        gravity=gravity,
        pose_prior=pose_prior or init,
        max_frames=max_frames,
        jobs=jobs,
        cluster=cluster,
        seed=seed,
        fresh=fresh,
        quiet=quiet,
    )
    folder = output or Path("results") / run.sequence.name
    if recording_path:
        from miniloop_cli.report.rerun import write_rerun

        write_rerun(run, folder, recording_path)
    numbers = Results(folder).summary
    if json_path:
        options.write_json(json_path, numbers)
    if not quiet and json_path != "-":
        print_summary(run, folder, numbers)
    _require_good(numbers["verdict"], folder, strict)


def _register_many(
    sequences: tuple[Path, ...], output: Path, json_path: str | None, strict: bool, quiet: bool, **chosen: Any
) -> None:
    """Register several recordings into one map."""
    from miniloop_cli.cli.map import describe
    from miniloop_cli.maps import register_many
    from miniloop_cli.runtime.allocator import KEPT_FOR_MAPS_BYTES, keep_freed_memory

    keep_freed_memory(KEPT_FOR_MAPS_BYTES)
    numbers = register_many(sequences, output, quiet=quiet, **chosen)
    if json_path:
        options.write_json(json_path, numbers)
    if not quiet and json_path != "-":
        for line in describe(output, numbers):
            click.echo(options.wrapped(line, " " * 12))
    _require_good(numbers["verdict"], output, strict)


def _require_good(verdict: dict[str, Any], folder: Path, strict: bool) -> None:
    """Raise MiniloopError with --strict for a result that is doubtful or bad."""
    if strict and verdict["level"] != "good":
        raise MiniloopError(f"the result is {verdict['level']}: {'; '.join(verdict['reasons'])} (see {folder})")
