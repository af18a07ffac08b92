"""A trajectory against its ground truth: one dictionary of numbers, with their protocol."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from miniloop_cli.errors import MiniloopError
from miniloop_cli.evaluation.agreement import in_our_convention
from miniloop_cli.evaluation.errors import consecutive_pairs, pairs_apart, relative_errors, statistics
from miniloop_cli.geometry.procrustes import align_points
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Floats, Ints


@dataclass(frozen=True)
class Protocol:
    """The protocol of the numbers. alignment: "SE3" or "Sim3"; association: "interpolate" or "nearest"."""

    alignment: str = "SE3"
    association: str = "interpolate"
    max_diff_s: float = 0.02  # a sample this near to a frame's stamp suffices
    max_gap_s: float = 0.1  # association "interpolate": or samples around the stamp that are at most this far apart
    delta_s: float = 1.0  # time between the frames of a pair in rpe "seconds"
    convention: str = "camera-to-world"  # of the ground truth: a name of geometry.conventions, or "body"

    def describe(self) -> str:
        """The association in words."""
        if self.association == "nearest":
            return f"nearest ground-truth sample within {1000 * self.max_diff_s:g} ms"
        ms = 1000 * np.array([self.max_diff_s, self.max_gap_s])
        return f"ground truth interpolated (sample within {ms[0]:g} ms or gap at most {ms[1]:g} ms)"


@dataclass(frozen=True)
class Evaluation:
    """The numbers (JSON-able), and the poses behind them for plots: (k,) stamps, aligned and true (k, 4, 4)."""

    numbers: dict[str, Any]
    timestamps_s: Floats
    T_aligned: Floats
    T_true: Floats

    @property
    def position_errors_m(self) -> Floats:
        """(k,) distances of the aligned positions to the true ones."""
        return np.linalg.norm(self.T_aligned[:, :3, 3] - self.T_true[:, :3, 3], axis=1)


def edge_rows(timestamps_s: Floats, edge_stamps_s: Floats) -> Ints:
    """(m, 2) rows of the (n,) sorted stamps for (e, 2) edges named by stamps; edges with a missing end left out."""
    if not len(edge_stamps_s) or not len(timestamps_s):
        return np.empty((0, 2), np.int64)
    rows = np.searchsorted(timestamps_s, edge_stamps_s - 1e-4)
    found = np.abs(timestamps_s[np.minimum(rows, len(timestamps_s) - 1)] - edge_stamps_s) <= 1e-4
    return rows[found.all(axis=1) & (rows < len(timestamps_s)).all(axis=1)]


def evaluate(
    trajectory: Trajectory,
    ground_truth: Trajectory,
    edge_stamps_s: Floats | None = None,
    protocol: Protocol | None = None,
    edges_are: str = "verified edges",
) -> Evaluation:
    """Absolute error after alignment on positions; relative errors over edges, consecutive poses and one second.

    `edge_stamps_s`: (e, 2) time stamps of the two frames of each edge of the overlap graph, `edges_are` their
    name in the protocol. Relative errors need no alignment; with "Sim3" they are measured on the scaled trajectory.
    "consecutive" are neighbours among the poses that have ground truth, as in evo.
    Raises MiniloopError if fewer than three poses have ground truth, and if its poses are of another convention.
    """
    protocol = protocol or Protocol()
    T_true, known = associate(
        trajectory.timestamps_s, ground_truth, protocol.association, protocol.max_diff_s, protocol.max_gap_s
    )
    stamps, T_est, T_true = trajectory.timestamps_s[known], trajectory.T_world_cam[known], T_true[known]
    if len(stamps) < 3:
        raise MiniloopError(
            f"{len(stamps)} of {len(known)} poses have ground truth (stamps {span(trajectory)} against "
            f"{span(ground_truth)}); at least 3 are needed: is it the ground truth of this sequence?"
        )
    T_true, notes = in_our_convention(T_est, T_true, protocol.convention, protocol.alignment == "Sim3")
    alignment = align_points(T_est[:, :3, 3], T_true[:, :3, 3], protocol.alignment == "Sim3")
    T_aligned = alignment.poses(T_est)
    ate = statistics(np.linalg.norm(T_aligned[:, :3, 3] - T_true[:, :3, 3], axis=1))
    shared = {"association": protocol.association, "max_diff_s": protocol.max_diff_s, "max_gap_s": protocol.max_gap_s}
    edges = np.empty((0, 2)) if edge_stamps_s is None else edge_stamps_s
    pairs = {
        "edges": (edge_rows(stamps, edges), edges_are),
        "consecutive": (consecutive_pairs(len(stamps)), "1 frame"),
        "seconds": (pairs_apart(stamps, protocol.delta_s), f"{protocol.delta_s:g} s +- 10 %"),
    }
    rpe: dict[str, dict[str, Any]] = {}
    for name, (rows, delta) in pairs.items():
        rot_deg, trans_m = relative_errors(T_aligned, T_true, rows)
        rpe[name] = {f"rot_deg_{key}": value for key, value in statistics(rot_deg).items()}
        rpe[name] |= {f"trans_m_{key}": value for key, value in statistics(trans_m).items()}
        rpe[name] |= {"pairs": len(rows), "protocol": {"delta": delta, "alignment": protocol.alignment} | shared}
    numbers: dict[str, Any] = {f"ate_{key}_m": ate[key] for key in ("rmse", "mean", "median", "max")}
    numbers |= {"poses": len(known), "poses_with_ground_truth": len(stamps), "scale": alignment.scale, "rpe": rpe}
    deltas = {name: delta for name, (_, delta) in pairs.items()}
    read = ", ".join(filter(None, (ground_truth.source, *notes)))
    numbers["protocol"] = {"alignment": protocol.alignment, "delta": deltas, "ground_truth": read} | shared
    return Evaluation(numbers, stamps, T_aligned, T_true)


def span(trajectory: Trajectory) -> str:
    """First and last time stamp, for a message."""
    return f"{trajectory.timestamps_s[0]:.3f} to {trajectory.timestamps_s[-1]:.3f}"
