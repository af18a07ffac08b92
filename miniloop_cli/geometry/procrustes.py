"""Least-squares motion between matched points."""

from __future__ import annotations

from miniloop_cli.geometry import se3
from miniloop_cli.typing import Floats


def procrustes(p: Floats, q: Floats) -> Floats:
    """Rigid (4, 4) that maps p (m, 3) onto q (m, 3), m >= 3, in least squares (Schönemann 1966; Arun et al. 1987)."""
    mean_p, mean_q = p.mean(axis=0), q.mean(axis=0)
    R = se3.project_so3((q - mean_q).T @ (p - mean_p))
    return se3.pose(R, mean_q - R @ mean_p)
