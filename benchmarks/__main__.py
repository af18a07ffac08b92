"""`python -m benchmarks NAME`, in the folder of the repository."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.of_programs import FOLDER, OF_PROGRAMS
from benchmarks.on_recordings import ON_RECORDINGS
from benchmarks.on_simulations import ON_SIMULATIONS
from miniloop_cli.cli.bench.factory import command
from miniloop_cli.cli.bench.table import SEQUENCES
from miniloop_cli.cli.main import CONTEXT, LazyGroup, main

FILE = click.Path(dir_okay=False, path_type=Path)


COMMANDS = [command(one) for one in sorted((*OF_PROGRAMS, *ON_RECORDINGS, *ON_SIMULATIONS), key=lambda one: one.name)]


@click.group(cls=LazyGroup, commands=COMMANDS, context_settings=CONTEXT)
def benchmarks() -> None:
    """What miniloop is measured by beside the paper's experiments (those are `miniloop bench`).

    \b
    Example:   python -m benchmarks ablation path/to/freiburg1_desk
    """


@benchmarks.command(context_settings=CONTEXT, short_help="Every kind of feature; a table on stdout.")
@SEQUENCES
@click.option("--max-frames", type=click.IntRange(min=2), help="Evenly spaced frames of SEQ [default: all].")
def features(sequences: tuple[Path, ...], max_frames: int | None) -> None:
    """Recordings registered with every kind of feature: accuracy, and CPU seconds from nothing.

    Relative errors of whole recordings are over the pairs listed in benchmarks/edges, where there is a list.

    \b
    Example:   python -m benchmarks features path/to/freiburg1_xyz_100 path/to/freiburg1_desk_100
    """
    from benchmarks.features import show

    show(sequences, max_frames)


@benchmarks.command(context_settings=CONTEXT, short_help="Faults that inspecting names; tables on stdout.")
@click.argument("sequences", nargs=-1, type=FOLDER)
@click.option("--seeds", type=click.IntRange(min=0), default=5, show_default=True, help="Simulated recordings a path.")
def inspection(sequences: tuple[Path, ...], seeds: int) -> None:
    """Sound recordings with one fault each: how often `miniloop inspect` names it, and what else it names.

    \b
    Example:   python -m benchmarks inspection path/to/freiburg1_desk_100 --seeds 2
    """
    from benchmarks.inspection import show

    show(sequences, seeds)


@benchmarks.command(name="locate", context_settings=CONTEXT, short_help="Left-out images found in a map; a table.")
@click.argument("sequence", type=FOLDER)
@click.option("--every", type=click.IntRange(min=2), default=5, show_default=True, help="Frames are left out so often.")
@click.option("--other", "others", type=FOLDER, multiple=True, help="A recording of another place; may be repeated.")
def located(sequence: Path, every: int, others: tuple[Path, ...]) -> None:
    """Frames of a whole recording looked for in the map of its other frames, against the map's own poses.

    \b
    Example:   python -m benchmarks locate path/to/freiburg1_desk --other path/to/another_room
    """
    from benchmarks.maps import show_located

    show_located(sequence, every, others)


@benchmarks.command(name="join", context_settings=CONTEXT, short_help="Recordings joined to one map; a table.")
@SEQUENCES
def joined(sequences: tuple[Path, ...]) -> None:
    """Recordings whose ground truths have one frame, joined: errors aligned alone and together.

    \b
    Example:   python -m benchmarks join path/to/freiburg1_xyz_100 path/to/freiburg1_desk_100
    """
    from benchmarks.maps import show_joined

    show_joined(sequences)


@benchmarks.command(name="add", context_settings=CONTEXT, short_help="A recording added to a map: cost, difference.")
@SEQUENCES
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="A setting; may be repeated.")
def added(sequences: tuple[Path, ...], overrides: tuple[str, ...]) -> None:
    """The last SEQ added to the map of the others: seconds, bytes, and the difference to registering all together.

    \b
    Example:   python -m benchmarks add path/to/monday path/to/tuesday path/to/wednesday
    """
    from benchmarks.map_growth import show_added

    show_added(sequences, overrides)


@benchmarks.command(context_settings=CONTEXT, short_help="`miniloop add` killed at random moments.")
@click.argument("result", type=FOLDER)
@click.argument("sequence", type=FOLDER)
@click.option("--count", type=click.IntRange(min=1), default=100, show_default=True, help="How often it is killed.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the moments.")
def kills(result: Path, sequence: Path, count: int, seed: int) -> None:
    """SEQUENCE added to copies of the map of RESULT, killed at random moments, then once more; hashes are checked.

    \b
    Example:   python -m benchmarks kills results/office path/to/kitchen --count 20
    """
    from benchmarks.map_kills import show_kills

    show_kills(result, sequence, count, seed)


@benchmarks.command(name="color-icp", context_settings=CONTEXT, short_help="Poses before and after colour ICP.")
@click.argument("result", type=FOLDER)
@click.argument("sequence", type=FOLDER)
@click.option("--edges", type=FILE, help="Pairs for the relative errors (lines 'i j') [default: the result's own].")
def color_icp(result: Path, sequence: Path, edges: Path | None) -> None:
    """Errors of a result, and of the same poses after colour ICP (Open3D) on the graph's strongest edges.

    \b
    Example:   python -m benchmarks color-icp results/freiburg1_desk path/to/freiburg1_desk
    """
    from benchmarks.color_icp import show

    show(result, sequence, edges)


@benchmarks.command(context_settings=CONTEXT, short_help="miniloop beside others; writes results.json.")
@SEQUENCES
@click.option(
    "--results", type=click.Path(file_okay=False, path_type=Path), default=Path("results/benchmark"), show_default=True
)
@click.option("--part", "parts", multiple=True, help="Measure only this part again; may be repeated.")
@click.option("--without", multiple=True, help="Leave this part out; may be repeated.")
def run(sequences: tuple[Path, ...], results: Path, parts: tuple[str, ...], without: tuple[str, ...]) -> None:
    """miniloop and others on the same frames, one after the other, each in a process of its own.

    Parts that are not measured keep what the results folder holds of them. Part "scaling" (simulated recordings of
    100 to 2000 frames) is measured only when it is named.

    \b
    Needs:     pip install -e '.[bench]'
               scripts/fetch_tum.sh --subset 100 freiburg1_xyz freiburg1_desk
    Example:   python -m benchmarks run data/tum/freiburg1_xyz_100 data/tum/freiburg1_desk_100
    """
    from benchmarks.side_by_side.run import run as measure

    measure(sequences, results, parts, without)


@benchmarks.command(context_settings=CONTEXT, short_help="Measured rows into results.json.")
@click.argument("name", type=click.Choice(["averaging", "camera-parts", "certificate-large", "growth", "whole"]))
@click.argument("rows", type=FILE)
def record(name: str, rows: Path) -> None:
    """Put a measured table into results.json; ROWS is what the command of that name wrote with --json.

    `certificate-large`: what `averaging --certificate` wrote.

    \b
    Example:   python -m benchmarks record whole whole.json
    """
    from benchmarks.side_by_side.report import read, record_rows

    record_rows(name, read(rows)["rows"])


@benchmarks.command(context_settings=CONTEXT, short_help="Figures of README and docs from results.json.")
@click.option("--check", is_flag=True, help="Write nothing; exit status 1 if a page is not up to date.")
def figures(check: bool) -> None:
    """Every figure of README, BENCHMARK.md and docs from benchmarks/results.json, and the list docs/figures.md.

    \b
    Example:   python -m benchmarks figures
    """
    from benchmarks.figures.pages import ROOT, update
    from benchmarks.figures.store import FigureError, load
    from benchmarks.figures.typed import check_typed_numbers

    stale = [page.relative_to(ROOT).as_posix() for page in update(load(), check)]
    if check and stale:
        raise FigureError(f"not up to date: {', '.join(stale)}; run python -m benchmarks figures")
    check_typed_numbers()
    click.echo(f"{len(stale)} pages changed" if stale else "all pages are up to date")


if __name__ == "__main__":
    main(command=benchmarks, program="python -m benchmarks")
