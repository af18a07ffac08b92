"""Errors of poses against exact truth, and against what their covariances promise."""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.procrustes import align_rotations
from miniloop_cli.typing import Floats


def aligned_errors(T_est: Floats, T_true: Floats) -> tuple[Floats, Floats]:
    """Metres (n,) and degrees (n,) of (n, 4, 4) poses after one rigid motion that fits both orientations and positions.

    Orientations decide the rotation, so that this is defined for two poses, for a camera that only turns, and for one
    that stands still, where an alignment on positions is not.
    """
    R = align_rotations(T_est[:, :3, :3], T_true[:, :3, :3])
    moved = T_est[:, :3, 3] @ R.T
    offset = T_true[:, :3, 3] - moved
    turned = np.swapaxes(T_true[:, :3, :3], 1, 2) @ (R @ T_est[:, :3, :3])
    return np.linalg.norm(offset - offset.mean(axis=0), axis=1), se3.rotation_angle_deg(turned)


def normalised_errors(T_est: Floats, T_true: Floats, covariance: Floats) -> Floats:
    """(k, 6) errors in units of their standard deviations: rotation, then translation along the camera's axes.

    covariance (n, 6, 6) of (w, v) in T_true = T_est [exp(w) | v], relative to the frame whose covariance is zero: the
    truth is moved so that it agrees there (k = n - 1). Frames without finite covariance are left out; (0, 6) where no
    frame is fixed.
    """
    variance = np.einsum("naa->na", covariance)
    fixed = np.flatnonzero((variance == 0).all(axis=1))
    if not len(fixed):
        return np.zeros((0, 6))
    known = np.isfinite(variance).all(axis=1) & (variance > 0).all(axis=1)
    truth = T_est[fixed[0]] @ se3.inverse(T_true[fixed[0]]) @ T_true[known]
    E = se3.inverse(T_est[known]) @ truth
    xi = np.concatenate([se3.log_so3(E[:, :3, :3]), E[:, :3, 3]], axis=1)
    return xi / np.sqrt(variance[known])


def within_2_sigma(normalised: Floats) -> float | None:
    """Share of the entries (k, 6) that are at most 2 in size; 95.4 % if Gaussian. None without any."""
    return float((np.abs(normalised) <= 2).mean()) if normalised.size else None
