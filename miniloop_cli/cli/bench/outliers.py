"""`miniloop bench outliers [SEQ...]`: false edges against averaging and refinement."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.bench.output import Row, outcome, shown, write
from miniloop_cli.cli.main import CONTEXT

SIMULATED = {"simulated-loop": "loop", "simulated-walk": "random-walk"}


@click.command(name="outliers", context_settings=CONTEXT, short_help="False edges against averaging and refinement.")
@click.argument("sequences", nargs=-1, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--simulated/--no-simulated", default=True, show_default=True, help="Also two simulated recordings.")
@click.option("--max-frames", type=click.IntRange(min=10), default=50, show_default=True, help="Scans a recording.")
@click.option(
    "--percent",
    type=click.FloatRange(min=0, max=90),
    multiple=True,
    default=(10, 20, 30, 40, 50),
    show_default=True,
    help="False edges among all; may be repeated.",
)
@click.option("--runs", type=click.IntRange(min=1), default=10, show_default=True, help="Graphs a kind and percentage.")
@click.option("--peers", is_flag=True, help="Also gtsam and pycolmap, where installed.")
@outcome("outliers")
@options.jobs
def bench_outliers(
    sequences: tuple[Path, ...],
    simulated: bool,
    max_frames: int,
    percent: tuple[float, ...],
    runs: int,
    peers: bool,
    output: Path | None,
    json_path: str | None,
    jobs: int,
    seed: int,
    quiet: bool,
) -> None:
    """The share of graphs with false edges whose poses are as good as twice the error without them.

    SEQ: recordings with ground truth. The true edges are the recording's own, as estimated; 10 to 50 % false ones are
    put in, random, or in clusters that agree with each other. `miniloop` may look at the scans behind an edge, as
    `miniloop register` does; `edges only`, and the peers, may not.

    \b
    Example:   miniloop bench outliers path/to/freiburg1_xyz --runs 5
    """
    from miniloop_cli.api import simulate
    from benchmarks.experiments.false_edges import true_graph
    from benchmarks.experiments.outliers import draw, outlier_rows
    from miniloop_cli.runtime.parallel import Workers

    shares, workers, rows = [value / 100 for value in percent], Workers(jobs, quiet), []
    with tempfile.TemporaryDirectory() as root:
        folders = list(sequences)
        for name, path in SIMULATED.items() if simulated else ():
            folders.append(simulate(Path(root) / name, seed=seed, frames=max_frames, width=320, height=240, path=path))
        for folder in folders:
            graph = true_graph(folder, max_frames, seed, workers)
            head = f"\n{graph.name}: {len(graph.scans)} scans, {len(graph.edges)} true edges"
            rows += shown(outlier_rows(graph, shares, runs, seed, peers), head, _line, json_path)
    write("outliers", rows, partial(draw, rows), output, json_path, quiet)


def _line(row: Row) -> str:
    text = f"{row['kind']:<11}{100 * row['false_share']:>4.0f} % false  {row['method']:<22}"
    for key, name in (("within_share", "poses"), ("rot_within_share", "rotations")):
        text += f"{name} within {'-' if row[key] is None else format(row[key], '.0%'):>5}  "
    for key, name in (("ate_cm_median", "cm"), ("rot_deg_median", "deg")):
        text += f"{'-' if row[key] is None else format(row[key], '.2f'):>7} {name}"
    return f"{text}  placed {row['posed_mean']:.0%}"
