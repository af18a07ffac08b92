"""Measured motions between frames in the refinement, for frames that share no points with others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.refinement.robust import Robust
from miniloop_cli.refinement.terms import Gauge
from miniloop_cli.scene.partial_motion import openness
from miniloop_cli.typing import Bools, Floats, Ints

KERNEL = Robust("cauchy", 3.0)


@dataclass(frozen=True)
class MotionTerm:
    """Measured T_j_i (m, 4, 4) of the frames (m, 2) rows (i, j), whitened by root (m, 6, 6): information = root^T root.

    Residuals and derivatives as in edge_terms: E = (T_world_j^-1 T_world_i) T_j_i^-1 = (R_E, t_E), r = (log R_E, t_E).
    """

    frames: Ints
    T_j_i: Floats
    root: Floats
    robust: Robust = KERNEL
    gauge: Gauge = Gauge.POSE

    @staticmethod
    def of(frames: Ints, T_j_i: Floats, information: Floats) -> MotionTerm:
        """With the information (m, 6, 6) of (w, v) in [exp(w) | v] T_j_i; unknown directions have no weight."""
        value, axes = np.linalg.eigh((information + information.transpose(0, 2, 1)) / 2)
        root = np.sqrt(np.maximum(value, 0.0))[:, :, None] * axes.transpose(0, 2, 1)
        return MotionTerm(frames, T_j_i, root)

    @property
    def full(self) -> Bools:
        """(m,) whether all directions of a motion were measured."""
        return np.isfinite(openness(self.root.transpose(0, 2, 1) @ self.root))

    def linearise(self, T_world_cam: Floats) -> tuple[Floats, Floats]:
        """Six numbers a motion between poses T_world_cam (n, 4, 4), in sigmas along the axes of its information."""
        i, j = self.frames.T
        E = se3.inverse(T_world_cam[j]) @ T_world_cam[i] @ se3.inverse(self.T_j_i)
        R_E, t_E = E[:, :3, :3], E[:, :3, 3]
        w = se3.log_so3(R_E)
        R, t = self.T_j_i[:, :3, :3], self.T_j_i[:, :3, 3]
        bend = inverse_right_jacobian(w)
        by_i, by_j = np.zeros((2, len(i), 6, 6))
        by_i[:, :3, :3] = bend @ R
        by_i[:, 3:, :3] = R_E @ se3.hat(t) @ R
        by_i[:, 3:, 3:] = R_E @ R
        by_j[:, :3, :3] = -bend.transpose(0, 2, 1)
        by_j[:, 3:, :3] = se3.hat(t_E)
        by_j[:, 3:, 3:] = -np.eye(3)
        residual = np.concatenate([w, t_E], axis=1)
        jacobian = np.stack([by_i, by_j], axis=1)
        return np.einsum("mab,mb->ma", self.root, residual), self.root[:, None] @ jacobian


def inverse_right_jacobian(w: Floats) -> Floats:
    """(m, 3, 3) of SO(3) at rotation vectors (m, 3) rad."""
    angle = np.linalg.norm(w, axis=1)
    safe = np.maximum(angle, 1e-6)
    exact = 1 / safe**2 - (1 + np.cos(safe)) / (2 * safe * np.sin(safe))
    factor = np.where(angle < 1e-3, 1 / 12, exact)
    W = se3.hat(w)
    return np.eye(3) + W / 2 + factor[:, None, None] * (W @ W)
