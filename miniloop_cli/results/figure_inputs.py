"""The lines of a figure from results and trajectories, in one world."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.errors import MiniloopError
from miniloop_cli.evaluation.evaluate import Evaluation, Protocol, evaluate
from miniloop_cli.evaluation.figure import Line, Panel
from miniloop_cli.results.evaluation_inputs import read_inputs, read_poses
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Floats

ERROR = Panel("position error (cm)", 100.0)
DIFFERENCE = Panel("distance to the first (cm)", 100.0)
SPEED = Panel("speed (m/s)", 1.0)

Figure = tuple[list[Line], Floats | None, Panel]


def figure_lines(
    sources: list[Path], truth: Path | None, with_scale: bool = False, follow_links: bool = False
) -> Figure:
    """Lines, the true path (n, 3) if there is one, and the quantity of the values.

    With a ground truth, every trajectory is aligned to it; without one, several are aligned to the first, and a single
    one shows its speed. Raises MiniloopError if they have no time in common.
    """
    names = labels(sources)
    protocol = Protocol("Sim3" if with_scale else "SE3")
    if truth is not None:
        given = [evaluate(*read_inputs(source, truth, None, protocol, follow_links)) for source in sources]
        longest = max(given, key=lambda found: len(found.timestamps_s))
        lines = [_line(name, found) for name, found in zip(names, given, strict=True)]
        return lines, longest.T_true[:, :3, 3], ERROR
    first, *others = [read_poses(source) for source in sources]
    if not others:
        return [_with_speed(names[0], first)], None, SPEED
    lines = [_with_values(names[0], first, np.zeros(len(first.timestamps_s)))]
    for name, source, trajectory in zip(names[1:], sources[1:], others, strict=True):
        try:
            lines.append(_line(name, evaluate(trajectory, first, protocol=protocol)))
        except MiniloopError as error:
            raise MiniloopError(f"{source} cannot be aligned to {sources[0]}: {error}") from error
    return lines, None, DIFFERENCE


def labels(sources: list[Path]) -> list[str]:
    """The shortest ends of the paths that are different."""
    parts = [path.resolve().parts for path in sources]
    for length in range(1, max(map(len, parts)) + 1):
        ends = ["/".join(part[-length:]) for part in parts]
        if len(set(ends)) == len(ends):
            return ends
    return ends


def _line(name: str, found: Evaluation) -> Line:
    positions = found.T_aligned[:, :3, 3]
    named = f"{name} ({100 * found.numbers['ate_rmse_m']:.2f} cm RMSE)"
    return Line(named, found.timestamps_s, positions, found.timestamps_s, found.position_errors_m)


def _with_values(name: str, trajectory: Trajectory, values: Floats) -> Line:
    stamps = trajectory.timestamps_s
    return Line(name, stamps, trajectory.T_world_cam[:, :3, 3], stamps, values)


def _with_speed(name: str, trajectory: Trajectory) -> Line:
    stamps, positions = trajectory.timestamps_s, trajectory.T_world_cam[:, :3, 3]
    if len(stamps) < 2:
        raise MiniloopError(f"{name} has {len(stamps)} poses; a figure needs at least 2")
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(stamps)
    return Line(name, stamps, positions, (stamps[1:] + stamps[:-1]) / 2, speed)
