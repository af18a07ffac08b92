"""Absolute and relative trajectory errors (Sturm et al., IROS 2012)."""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.scene.interpolation import nearest
from miniloop_cli.typing import Floats, Ints


def relative_errors(T_est: Floats, T_true: Floats, pairs: Ints) -> tuple[Floats, Floats]:
    """Degrees (m,) and metres (m,) of E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j) for (m, 2) row pairs of (n, 4, 4) P and Q."""
    i, j = pairs[:, 0], pairs[:, 1]
    E = se3.inverse(se3.inverse(T_true[i]) @ T_true[j]) @ (se3.inverse(T_est[i]) @ T_est[j])
    return se3.angle_and_distance(E)


def consecutive_pairs(n: int) -> Ints:
    """(n - 1, 2): each pose with the next."""
    return np.stack([np.arange(n - 1), np.arange(1, n)], axis=1) if n > 1 else np.empty((0, 2), np.int64)


def pairs_apart(timestamps_s: Floats, delta_s: float, tolerance: float = 0.1) -> Ints:
    """(m, 2) rows: each pose with the one nearest to `delta_s` later, if that is within the share `tolerance` of it.

    timestamps_s (n,), sorted.
    """
    if len(timestamps_s) < 2:
        return np.empty((0, 2), np.int64)
    i = np.arange(len(timestamps_s))
    j = nearest(timestamps_s, timestamps_s + delta_s)
    met = (j > i) & (np.abs(timestamps_s[j] - timestamps_s - delta_s) <= tolerance * delta_s)
    return np.stack([i[met], j[met]], axis=1)


def statistics(errors: Floats) -> dict[str, float | None]:
    """mean, median, rmse, max of (n,) errors; None if there are none."""
    if not len(errors):
        return dict.fromkeys(("mean", "median", "rmse", "max"))
    return {
        "mean": float(errors.mean()),
        "median": float(np.median(errors)),
        "rmse": float(np.sqrt((errors**2).mean())),
        "max": float(errors.max()),
    }
