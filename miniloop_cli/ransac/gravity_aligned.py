"""The robust estimator with a roughly known vertical of every scan, which guides the search but not the final fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.config import Ransac
from miniloop_cli.geometry import se3
from miniloop_cli.ransac.estimate import CycleEstimate, estimate, refit
from miniloop_cli.ransac.matches import EdgeMatches
from miniloop_cli.typing import Floats


def upright_rotations(up_cam: Floats) -> Floats:
    """(n, 3, 3) least rotations that turn the unit vectors up_cam (n, 3) onto the axis z."""
    z = np.array([0.0, 0.0, 1.0])
    axis, cosine = np.cross(up_cam, z), up_cam @ z
    W = se3.hat(axis)
    # The rotation between two unit vectors: I + W + W^2 / (1 + cos); a half turn about x where they are opposite.
    R = np.eye(3) + W + W @ W / np.maximum(1 + cosine, 1e-9)[:, None, None]
    return np.where((cosine < -1 + 1e-9)[:, None, None], np.diag([1.0, -1.0, -1.0]), R)


def estimate_upright(
    edges: Sequence[EdgeMatches],
    up_cam: Floats,
    sigma_rad: float,
    settings: Ransac,
    chi2_gate: float,
    rng: np.random.Generator,
) -> CycleEstimate | None:
    """`estimate` of a pair or a cycle of 3 or 4 scans whose verticals up_cam (n, 3), in their own frames, are known.

    The search uses the verticals with standard deviation `sigma_rad`; the poses returned are fitted without them.
    """
    R = upright_rotations(up_cam)
    scans = len(up_cam)
    chain = [(k, k + 1) for k in range(scans - 1)] + ([(0, scans - 1)] if scans > 2 else [])
    upright = [_turned(edge, R[a], R[b], sigma_rad) for edge, (a, b) in zip(edges, chain, strict=True)]
    found = estimate(upright, settings, chi2_gate, rng, upright=True)
    if found is None:
        return None
    T = np.array([edge.T for edge in found.edges[: scans - 1]])
    for k, pose in enumerate(T):
        pose[:3, :3] = R[k + 1].T @ pose[:3, :3] @ R[k]
        pose[:3, 3] = R[k + 1].T @ pose[:3, 3]
    return refit(edges, np.ascontiguousarray(T[:, :3]), settings, chi2_gate, found.hypotheses)


def _turned(edge: EdgeMatches, R_p: Floats, R_q: Floats, sigma_rad: float) -> EdgeMatches:
    """The matches in upright frames, their covariances increased by the error of the verticals."""

    def widened(points: Floats, covariances: Floats, R: Floats) -> Floats:
        return R @ covariances @ R.T + (sigma_rad**2 * (points**2).sum(axis=1))[:, None, None] * np.eye(3)

    return EdgeMatches(
        edge.p @ R_p.T, edge.q @ R_q.T, widened(edge.p, edge.cov_p, R_p), widened(edge.q, edge.cov_q, R_q)
    )
