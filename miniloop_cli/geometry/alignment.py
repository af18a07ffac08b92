"""The similarity or rigid motion that brings one point set nearest to another (Umeyama, PAMI 1991)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.errors import MiniloopError
from miniloop_cli.typing import Floats


@dataclass(frozen=True)
class Alignment:
    """p_target = scale R p_source + t."""

    R: Floats
    t: Floats
    scale: float = 1.0

    def points(self, p: Floats) -> Floats:
        """(n, 3) source points to target points."""
        return self.scale * p @ self.R.T + self.t

    def poses(self, T: Floats) -> Floats:
        """(n, 4, 4) poses in the source world to poses in the target world."""
        out = T.copy()
        out[:, :3, :3] = self.R @ T[:, :3, :3]
        out[:, :3, 3] = self.points(T[:, :3, 3])
        return out


def umeyama(source: Floats, target: Floats, with_scale: bool = False) -> Alignment:
    """Least-squares alignment of (n, 3) `source` to (n, 3) `target` points; SE(3), or Sim(3) with scale.

    For points on a line the rotation about the line is arbitrary (the residuals are not).
    Raises MiniloopError for a scale where all source points coincide.
    """
    mean_s, mean_t = source.mean(0), target.mean(0)
    U, D, Vt = np.linalg.svd((target - mean_t).T @ (source - mean_s) / len(source))
    sign = np.array([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)])
    R = (U * sign) @ Vt
    scale = 1.0
    if with_scale:
        variance = ((source - mean_s) ** 2).sum(1).mean()
        if variance == 0:
            raise MiniloopError("no scale can be found: all positions of the trajectory coincide; use SE(3) alignment")
        scale = float(D @ sign / variance)
    return Alignment(R, mean_t - scale * R @ mean_s, scale)
