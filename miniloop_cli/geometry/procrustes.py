"""The rotation, rigid motion or similarity that maps one set to another with least squared error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
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
        return se3.pose(self.R @ T[:, :3, :3], self.points(T[:, :3, 3]))


def align_points(source: Floats, target: Floats, with_scale: bool = False) -> Alignment:
    """Alignment of (n, 3) `source` to (n, 3) `target` points; SE(3), or Sim(3) with scale (Umeyama, PAMI 1991).

    For points on a line the rotation about the line is arbitrary (the residuals are not).
    Raises MiniloopError if a scale is wanted and all source points coincide.
    """
    mean_s, mean_t = source.mean(axis=0), target.mean(axis=0)
    covariance = (target - mean_t).T @ (source - mean_s)
    R, scale = se3.project_so3(covariance), 1.0
    if with_scale:
        spread = ((source - mean_s) ** 2).sum()
        if spread == 0:
            raise MiniloopError("no scale can be found: all positions of the trajectory coincide; use SE(3) alignment")
        scale = float((R * covariance).sum() / spread)
    return Alignment(R, mean_t - scale * R @ mean_s, scale)


def align_rotations(source: Floats, target: Floats, weights: Floats | None = None) -> Floats:
    """The rotation R (3, 3) with target = R source, for (n, 3, 3) rotations, each weighted by its (n,) weight."""
    w = np.ones(len(source)) if weights is None else weights
    return se3.project_so3(np.einsum("nab,ncb,n->ac", target, source, w))
