"""A recording with its matches and true poses, for experiments on edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.bench.overlaps import open_with_truth
from miniloop_cli.config import Settings
from miniloop_cli.geometry import se3
from miniloop_cli.ransac.matches import edge_matches
from miniloop_cli.runtime.artifact_store import Store, default_folder
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.points import Matches, ScanPoints
from miniloop_cli.scene.scan_set import ScanSet
from miniloop_cli.stages.candidates import comparer, listed_pairs
from miniloop_cli.stages.extract import extract
from miniloop_cli.stages.run import Run
from miniloop_cli.typing import Bools, Floats, Ints, Pair

RIGHT_DEG, RIGHT_M = 5.0, 0.10  # an edge with a larger error is wrong


@dataclass(frozen=True)
class Overlaps:
    """Scans, their points, matches of their pairs; true poses T_world_cam (n, 4, 4), `known` (n,) or not."""

    scans: ScanSet
    matches: Matches
    T_world_cam: Floats
    known: Bools

    @property
    def name(self) -> str:
        """The recording's."""
        return self.scans.sequence.name

    @property
    def points(self) -> Sequence[ScanPoints]:
        """Features with depth of each scan, in space."""
        return self.scans.points

    def errors(self, pairs: ArrayLike, T_j_i: Floats) -> tuple[Floats, Floats]:
        """Errors, degrees (m,) and metres (m,), of relative poses (m, 4, 4) of pairs; of scan j relative to i."""
        i, j = np.asarray(pairs, np.int64).reshape(-1, 2).T
        E = se3.inverse(self.T_world_cam[i]) @ self.T_world_cam[j] @ np.reshape(T_j_i, (-1, 4, 4))
        return se3.angle_and_distance(E)

    def true_matches(self, pair: Pair, rows: Ints) -> int:
        """Number of matches (m, 2) within RIGHT_M under the true relative pose."""
        edge = edge_matches(self.points, pair, rows)
        T_j_i = se3.inverse(self.T_world_cam[pair[1]]) @ self.T_world_cam[pair[0]]
        return int((np.linalg.norm(se3.transform(T_j_i, edge.p) - edge.q, axis=1) < RIGHT_M).sum())


def right(deg: Floats, metres: Floats) -> Bools:
    """Whether (m,) errors deg (m,) and metres (m,) are those of right edges."""
    return (deg < RIGHT_DEG) & (metres < RIGHT_M)


def read_overlaps(folder: Path, settings: Settings, max_frames: int | None, workers: Workers) -> Overlaps:
    """Features and matches of all pairs of a recording. Raises InputError if it has no ground truth."""
    sequence, truth = open_with_truth(folder, max_frames)
    scans = extract(sequence, settings.features, settings.depth, Run(Store(default_folder()), workers))
    pairs = listed_pairs(len(scans), "auto", settings.matching)
    matches = comparer(scans, settings.matching, workers)(pairs)
    T_world_cam, known = associate(np.array([frame.timestamp_s for frame in sequence.frames]), truth)
    return Overlaps(scans, matches, T_world_cam, known)
