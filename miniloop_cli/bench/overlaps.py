"""The overlap graph of a recording with every pair compared in full, as in the paper, and its true poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from miniloop_cli.config import Settings
from miniloop_cli.datasets import open_sequence, read_ground_truth
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.points import Matches, ScanPoints
from miniloop_cli.scene.priors import Priors
from miniloop_cli.scene.sequence import Sequence, Trajectory
from miniloop_cli.stages.extract import extract
from miniloop_cli.stages.match import match
from miniloop_cli.stages.run import Run
from miniloop_cli.typing import Bools, Floats

# Edges of the paper's graphs of 100 scans each. The paper does not give T, so ours follows from the number of edges.
PAPER_EDGES = {"freiburg1_room": 435, "freiburg1_xyz": 1751, "freiburg2_desk": 687}
PAPER_PAIRS, OTHERS = 100 * 99 // 2, "freiburg2_desk"


@dataclass(frozen=True)
class Overlaps:
    """A recording with ground truth, its scans' points, and the matches of every pair that has at least three."""

    sequence: Sequence
    truth: Trajectory
    points: list[ScanPoints]
    matches: Matches

    @property
    def stamps_s(self) -> Floats:
        """(n,) time stamps of the scans."""
        return np.array([frame.timestamp_s for frame in self.sequence.frames])

    @cached_property
    def true_poses(self) -> tuple[Floats, Bools]:
        """T_world_cam (n, 4, 4) by the ground truth, and (n,) whether it covers that scan."""
        return associate(self.stamps_s, self.truth)

    def true_motion(self, i: int, j: int) -> Floats:
        """T_j_i (4, 4) by the ground truth."""
        T, _ = self.true_poses
        return se3.inverse(T[j]) @ T[i]

    def with_matches(self, least: int) -> Matches:
        """The edges of the paper's graph: pairs with at least `least` matches, T in the paper."""
        return {pair: rows for pair, rows in self.matches.items() if len(rows) >= least}

    @cached_property
    def least_as_in_paper(self) -> int:
        """The T that keeps the paper's share of the pairs: for this sequence, else for its middle one."""
        count = len(self.points)
        edges = PAPER_EDGES[paper_sequence(self.sequence.name) or OTHERS]
        return self.least_for(round(edges / PAPER_PAIRS * count * (count - 1) / 2))

    def least_for(self, edges: int) -> int:
        """The T whose graph has the number of edges nearest to `edges`."""
        counts = np.sort([len(rows) for rows in self.matches.values()])[::-1]
        if not len(counts):
            return 3
        candidates = np.unique(counts)
        sizes = np.array([(counts >= least).sum() for least in candidates])
        return int(candidates[np.argmin(np.abs(sizes - edges))])


def paper_sequence(name: str) -> str | None:
    """The paper's sequence in a recording's name, if any."""
    return next((known for known in PAPER_EDGES if known in name), None)


def open_with_truth(folder: Path, max_frames: int | None = None) -> tuple[Sequence, Trajectory]:
    """A recording and its ground truth. Raises InputError for one without."""
    sequence = open_sequence(folder, max_frames=max_frames)
    truth = read_ground_truth(sequence)
    if truth is None:
        raise InputError(f"{folder} has no ground truth, which this benchmark needs; choose a recording that has one")
    return sequence, truth


def overlaps(folder: Path, settings: Settings, workers: Workers) -> Overlaps:
    """Matches of all pairs, by the detector, the number of features and the ratio test of the settings."""
    sequence, truth = open_with_truth(folder)
    run = Run(Store(default_folder()), workers)
    scans = extract(sequence, settings.features, settings.depth, run)
    full = settings.matching.model_copy(update={"min_matches": 3, "pairs": "exhaustive", "edge_share": 0.0})
    matches = match(scans, full, settings.pose_prior, Priors(), run)
    return Overlaps(sequence, truth, scans.points, matches)
