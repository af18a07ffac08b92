"""`miniloop eval`: a trajectory against its ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from miniloop_cli.cli import options
from miniloop_cli.cli.main import CONTEXT

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from miniloop_cli.evaluation.results import Results
    from miniloop_cli.scans.sequence import Trajectory

RPE_TITLES = {"edges": "graph edges", "consecutive": "consecutive", "seconds": "one second"}


@click.command(name="eval", context_settings=CONTEXT)
@click.argument("result", required=False, type=click.Path(exists=True, path_type=Path))
@click.option(
    "--gt",
    required=True,
    type=click.Path(exists=True, path_type=Path),
    help="Ground truth: a TUM trajectory, or a sequence that has one.",
)
@click.option(
    "--edges",
    "edges_path",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Edges of the relative errors: lines 'i j' of frame numbers [default: the result's edges.csv].",
)
@click.option(
    "--association",
    type=click.Choice(["interpolate", "nearest"]),
    default="interpolate",
    show_default=True,
    help="Ground truth at a frame's stamp; nearest is what evo and the TUM scripts do.",
)
@click.option(
    "--max-diff",
    type=click.FloatRange(min=0),
    default=0.02,
    show_default=True,
    metavar="SECONDS",
    help="A ground-truth sample this near is always enough.",
)
@click.option(
    "--max-gap",
    type=click.FloatRange(min=0),
    default=0.1,
    show_default=True,
    metavar="SECONDS",
    help="interpolate: samples at most this far apart are enough too.",
)
@click.option("--scale", is_flag=True, help="Align with a free scale (Sim3) instead of a rigid motion.")
@options.json_file
@click.option(
    "--plot",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Write trajectory.png and errors.png into DIR.",
)
def evaluate(
    result: Path | None,
    gt: Path,
    edges_path: Path | None,
    association: str,
    max_diff: float,
    max_gap: float,
    scale: bool,
    json_path: str | None,
    plot: Path | None,
) -> None:
    """Absolute and relative errors of RESULT (a results folder or a TUM trajectory; default: the newest result).

    \b
    Example:   miniloop eval results/desk --gt data/freiburg1_desk --plot results/desk
    """
    from miniloop_cli.evaluation.evaluate import Protocol
    from miniloop_cli.evaluation.evaluate import evaluate as run
    from miniloop_cli.evaluation.results import Results, newest_result, read_edge_list
    from miniloop_cli.scans.trajectory import read_trajectory

    source = result or newest_result()
    file = source / "trajectory.txt" if source.is_dir() else source
    # A trajectory of another name does not belong to the run whose folder it may lie in.
    folder = Results(file.parent) if file.name == "trajectory.txt" else None
    trajectory = folder.trajectory if folder else read_trajectory(file)
    if edges_path and edges_path.suffix != ".csv":
        edges = read_edge_list(edges_path, frame_stamps(folder, gt))
    elif edges_path:
        edges = rows_of(edges_path)
    else:
        edges = folder.edge_stamps_s if folder else None
    protocol = Protocol("Sim3" if scale else "SE3", association, max_diff, max_gap)
    edges_are = f"edges of {edges_path.name}" if edges_path else "verified edges"
    evaluation = run(trajectory, ground_truth(gt), edges, protocol, edges_are)
    if json_path != "-":
        click.echo(table(evaluation.numbers, str(source), protocol.describe()))
    if json_path:
        options.write_json(json_path, {"trajectory": str(source), "ground_truth": str(gt)} | evaluation.numbers)
    if plot:
        from miniloop_cli.evaluation.plots import write_plots

        for path in write_plots(evaluation, plot):
            click.echo(f"wrote {path}", err=True)


def ground_truth(gt: Path) -> Trajectory:
    """The trajectory behind --gt: a file, a TUM folder's groundtruth.txt, or what another layout comes with."""
    from miniloop_cli.errors import InputError
    from miniloop_cli.scans import open_sequence, read_ground_truth
    from miniloop_cli.scans.trajectory import read_trajectory

    if gt.is_file():
        return read_trajectory(gt)
    if (gt / "groundtruth.txt").is_file():
        return read_trajectory(gt / "groundtruth.txt")
    truth = read_ground_truth(open_sequence(gt))
    if truth is None:
        raise InputError(f"{gt} comes without ground truth (no groundtruth.txt): give a trajectory file to --gt")
    return truth


def rows_of(path: Path) -> NDArray[np.float64]:
    """Edge stamps of another run's edges.csv."""
    from miniloop_cli.evaluation.results import edge_stamps, read_table

    return edge_stamps(read_table(path), path)


def frame_stamps(folder: Results | None, gt: Path) -> NDArray[np.float64]:
    """(n,) time stamps of the recording's frames by number: from the result's frames.csv, else from the recording."""
    import numpy as np

    from miniloop_cli.errors import InputError
    from miniloop_cli.scans import open_sequence

    if folder and len(folder.frame_stamps_s):
        return folder.frame_stamps_s
    if gt.is_dir():
        return np.array([frame.timestamp_s for frame in open_sequence(gt).frames])
    raise InputError("frame numbers need the recording's time stamps: give its folder to --gt")


def table(numbers: dict[str, Any], source: str, association: str) -> str:
    """The numbers as a table of at most 80 columns, with the protocol beside them."""
    alignment = numbers["protocol"]["alignment"]
    scale = f", scale {numbers['scale']:.5f}" if alignment == "Sim3" else ""
    lines = [
        source,
        f"{numbers['poses_with_ground_truth']} of {numbers['poses']} poses have ground truth",
        association,
        "",
        f"{'ATE':<14}{'rmse':>9}{'mean':>9}{'median':>9}{'max':>9}   {alignment}-aligned positions{scale}",
        f"{'cm':<14}" + "".join(f"{100 * numbers[f'ate_{key}_m']:9.3f}" for key in ("rmse", "mean", "median", "max")),
        "",
        f"{'relative':<14}{'mean':>9}{'median':>9}{'mean':>9}{'median':>9}   pairs",
        f"{'':<14}{'deg':>9}{'deg':>9}{'cm':>9}{'cm':>9}",
    ]
    for name, title in RPE_TITLES.items():
        row = numbers["rpe"][name]
        if not row["pairs"]:
            lines.append(f"{title:<14}{'-':>9}{'-':>9}{'-':>9}{'-':>9}   none")
            continue
        values = [row["rot_deg_mean"], row["rot_deg_median"], 100 * row["trans_m_mean"], 100 * row["trans_m_median"]]
        lines.append(
            f"{title:<14}" + "".join(f"{v:9.3f}" for v in values) + f"   {row['pairs']} ({row['protocol']['delta']})"
        )
    return "\n".join(lines)
