"""The summary of a run that `miniloop register` prints."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from miniloop_cli.cli import options

if TYPE_CHECKING:
    from miniloop_cli.scene.registration import Registration

MOST_REASONS = 8  # shown at most


def _followed_words(numbers: dict[str, Any]) -> str:
    """The numbers of keyframes and tracked frames in words."""
    return f"{numbers['keyframes']}; points were followed through the frames between them"


def print_summary(run: Registration, folder: Path, numbers: dict[str, Any]) -> None:
    """Print the results as a table of 80 columns; the verdict last."""
    import numpy as np

    from miniloop_cli.results.calibration import one_line
    from miniloop_cli.results.facts import runs
    from miniloop_cli.results.tables import frame_status

    seconds = numbers["timings_s"]
    solved = [(f"{kind}-cycles" if kind.isdigit() else kind, count) for kind, count in numbers["cycles"].items()]
    rows = {
        "registered": f"{numbers['registered']} of {numbers['frames']} frames",
        **({"keyframes": _followed_words(numbers)} if numbers["keyframes"] < numbers["frames"] else {}),
        "camera": numbers["camera"],
        **({"calibrated": one_line(numbers["calibration"])} if "calibration" in numbers else {}),
        "edges": f"{numbers['edges']} verified; pairs by solver, verified or not: "
        + ", ".join(f"{k} {count}" for k, count in solved),
        "seconds": f"{sum(seconds.values()):.1f}: " + ", ".join(f"{stage} {s:.1f}" for stage, s in seconds.items()),
        "results": str(folder),
        "report": str(folder / "report.html"),
    }
    if numbers["components"] > 1:
        rows["pieces"] = ", ".join(map(str, numbers["component_sizes"])) + " frames, not joined to each other"
    for name, text in rows.items():
        click.echo(options.wrapped(f"{name:<12}{text}", " " * 12))
    reasons: dict[str, list[int]] = {}
    for index in range(numbers["frames"]):
        if run.poses.component[index] != 0:
            reasons.setdefault(frame_status(run, index)[1], []).append(index)
    for why, frames in sorted(reasons.items(), key=lambda item: (-len(item[1]), item[1]))[:MOST_REASONS]:
        named = f"frame{'s' * (len(frames) > 1)} {runs(np.array(frames))}"
        # Messages on unreadable files name their frame already.
        click.echo(options.wrapped("no pose for " + (why if why.startswith("frame ") else f"{named}: {why}")))
    if len(reasons) > MOST_REASONS:
        click.echo(f"... and more: see {folder / 'frames.csv'}")
    verdict = numbers["verdict"]
    for text in (f"{verdict['level']:<12}{verdict['headline']}", *(f"{'':<12}{why}" for why in verdict["reasons"])):
        click.echo(options.wrapped(text, " " * 12))
