"""The ground truth of a recording, for pages that show it."""

from __future__ import annotations

from miniloop_cli.datasets import read_ground_truth
from miniloop_cli.errors import MiniloopError
from miniloop_cli.evaluation.evaluate import Evaluation, evaluate
from miniloop_cli.results.columns import ReportData
from miniloop_cli.scene.sequence import Trajectory


def against_truth(data: ReportData, trajectory: Trajectory | None) -> Evaluation | None:
    """The evaluation, if the recording has a matching ground truth; an invalid one is ignored."""
    if trajectory is None or data.sequence is None:
        return None
    try:
        truth = read_ground_truth(data.sequence)
        return evaluate(trajectory, truth, data.results.edge_stamps_s) if truth else None
    except MiniloopError:
        return None
