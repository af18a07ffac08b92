"""The ground truth's pose at each frame's time stamp."""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Bools, Floats, Ints


def nearest(stamps_s: Floats, query_s: Floats) -> Ints:
    """Index of the nearest of the (n,) sorted `stamps_s` for each of the (m,) queries; a tie goes to the earlier."""
    after = np.clip(np.searchsorted(stamps_s, query_s), 0, len(stamps_s) - 1)
    before = np.maximum(after - 1, 0)
    earlier = np.abs(query_s - stamps_s[before]) <= np.abs(stamps_s[after] - query_s)
    return np.where(earlier, before, after)


def interpolate(trajectory: Trajectory, query_s: Floats) -> Floats:
    """(m, 4, 4) poses of the trajectory at (m,) times: slerp and linear; the end poses outside its span."""
    stamps, T = trajectory.timestamps_s, trajectory.T_world_cam
    if len(stamps) == 1:
        return np.repeat(T, len(query_s), axis=0)
    right = np.clip(np.searchsorted(stamps, query_s), 1, len(stamps) - 1)
    a, b = T[right - 1], T[right]
    share = np.clip((query_s - stamps[right - 1]) / (stamps[right] - stamps[right - 1]), 0.0, 1.0)[:, None]
    w = se3.log_so3(np.swapaxes(a[:, :3, :3], 1, 2) @ b[:, :3, :3])
    return se3.pose(a[:, :3, :3] @ se3.exp_so3(share * w), (1 - share) * a[:, :3, 3] + share * b[:, :3, 3])


def associate(
    timestamps_s: Floats,
    ground_truth: Trajectory,
    association: str = "interpolate",
    max_diff_s: float = 0.02,
    max_gap_s: float = 0.1,
) -> tuple[Floats, Bools]:
    """(n, 4, 4) ground-truth poses at (n,) frame stamps, and (n,) whether each is valid.

    "interpolate": between the two samples around the stamp (before the first and after the last: that sample), if
    they are at most `max_gap_s` apart or one of them is within `max_diff_s` of the stamp. "nearest": the nearest
    sample, if within `max_diff_s`, as evo and the TUM scripts do; the earlier sample in a tie.
    """
    stamps = ground_truth.timestamps_s
    index = nearest(stamps, timestamps_s)
    near = np.abs(stamps[index] - timestamps_s) <= max_diff_s
    if association == "nearest":
        return ground_truth.T_world_cam[index], near
    right = np.clip(np.searchsorted(stamps, timestamps_s), 1, max(len(stamps) - 1, 1))
    inside = (timestamps_s >= stamps[0]) & (timestamps_s <= stamps[-1])
    gap = stamps[np.minimum(right, len(stamps) - 1)] - stamps[right - 1]
    return interpolate(ground_truth, timestamps_s), near | (inside & (gap <= max_gap_s))
