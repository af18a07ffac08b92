"""The input of an export: poses with their frame numbers, the pose graph, and, if needed, the recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from miniloop_cli.config import Depth
from miniloop_cli.datasets import read_scan
from miniloop_cli.datasets.confidence import with_min_confidence
from miniloop_cli.errors import InputError
from miniloop_cli.presets import load_settings
from miniloop_cli.results.folder import Results
from miniloop_cli.results.g2o import PoseGraph, read_g2o
from miniloop_cli.scene.interpolation import nearest
from miniloop_cli.scene.sequence import Scan, Sequence, Trajectory
from miniloop_cli.typing import Floats, Ints

SAME_STAMP_S = 1e-4


@dataclass(frozen=True)
class Model:
    """A results folder and, for formats that need images or the camera, its recording, or why it is not available."""

    results: Results
    sequence: Sequence | None = None
    problem: str = ""

    @property
    def trajectory(self) -> Trajectory:
        """Stamps (s) and T_world_cam of the registered frames."""
        return self.results.trajectory

    @cached_property
    def frame_numbers(self) -> Ints:
        """(n,) number in the recording of each pose: by frames.csv, else by the recording, else 0, 1, 2 ..."""
        stamps = self.trajectory.timestamps_s
        if len(self.results.frame_stamps_s):
            return rows_of(self.results.frame_stamps_s, stamps, self.results.root / "frames.csv")
        return self.recording_rows if self.sequence else np.arange(len(stamps))

    @cached_property
    def graph(self) -> PoseGraph:
        """graph.g2o with the poses of trajectory.txt; without the file, a graph of poses only. Raises InputError."""
        path, T = self.results.root / "graph.g2o", self.trajectory.T_world_cam
        if not path.is_file():
            nothing = np.empty((0, 6, 6))
            return PoseGraph(self.frame_numbers, T, np.empty((0, 2), np.int64), nothing[:, :4, :4], nothing)
        graph = read_g2o(path)
        if not np.isin(graph.pairs, self.frame_numbers).all():
            raise InputError(f"{path} has edges of frames that are not in trajectory.txt: files of different runs")
        return PoseGraph(self.frame_numbers, T, graph.pairs, graph.T_j_i, graph.information)

    @cached_property
    def pair_rows(self) -> Ints:
        """(m, 2) the graph's edges as rows of the trajectory."""
        return np.searchsorted(self.frame_numbers, self.graph.pairs)

    @cached_property
    def recording(self) -> Sequence:
        """The sequence, with the depth that the run used. Raises InputError if it is not available."""
        if self.sequence is None:
            why = f" ({self.problem})" if self.problem else ""
            raise InputError(f"this needs the images and the camera: give the recording with --sequence{why}")
        whole, _ = self.sequence.with_color_only()
        took_part = len(self.results.frame_stamps_s) == len(whole.frames)
        return with_min_confidence(whole if took_part else self.sequence, self.depth_settings.min_confidence)

    @cached_property
    def recording_rows(self) -> Ints:
        """(n,) index into the recording's frames of each pose, by time stamp."""
        known = np.array([frame.timestamp_s for frame in self.recording.frames])
        return rows_of(known, self.trajectory.timestamps_s, self.recording.root)

    @cached_property
    def depth_settings(self) -> Depth:
        """The depth settings of the run; the default without its config.yaml. Raises ConfigError if that is damaged."""
        path = self.results.root / "config.yaml"
        return load_settings(path).depth if self.results.summary and path.is_file() else Depth()

    @property
    def depth_range_m(self) -> tuple[float, float]:
        """Nearest and farthest depth (m) that the run used."""
        return self.depth_settings.min_m, self.depth_settings.max_m

    def scan(self, row: int) -> Scan:
        """Frame `row` of the recording, with depth 0 where the run did not use it. Raises InputError as `read_scan`."""
        scan = read_scan(self.recording, row)
        near, far = self.depth_range_m
        used = (scan.depth_m >= near) & (scan.depth_m <= far)
        return replace(scan, depth_m=np.where(used, scan.depth_m, np.float32(0)))


def rows_of(known_s: Floats, stamps_s: Floats, where: Path) -> Ints:
    """(n,) row of each of `stamps_s` (n,) among the sorted `known_s` (k,). Raises InputError for one not among them."""
    if not len(known_s):
        raise InputError(f"{where} has no frames")
    rows = nearest(known_s, stamps_s)
    strange = np.flatnonzero(np.abs(known_s[rows] - stamps_s) > SAME_STAMP_S)
    if len(strange):
        raise InputError(f"trajectory.txt has stamp {stamps_s[strange[0]]:.6f}, {where} has not: another recording?")
    return rows
