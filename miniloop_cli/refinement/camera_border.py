"""The equations of camera parameters, from which those of the points are eliminated.

Let h be a row's mixed second derivative by its point in the camera's frame (3) and by the parameters (q), C and c the
parameters' own Hessian and gradient. With A, a, B, R, V as in schur.py, the point depends on the parameters by
W = sum R h, and eliminating it leaves, with Z = V^-1 W,
  C - sum W^T Z,   c - sum Z^T sum R a,   and, for the pose of a row, B^T (h - A R^T Z).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from miniloop_cli.refinement.free_terms import FreeTerm
from miniloop_cli.refinement.point_equations import LEAST_CURVATURE, PointEquations
from miniloop_cli.refinement.robust import weight_and_curvature
from miniloop_cli.refinement.terms import NEAR_M
from miniloop_cli.refinement.track_rows import TrackRows
from miniloop_cli.typing import Bools, Floats, Ints


class ParameterEquations(NamedTuple):
    """Of each row: mixed (k, 3, q) by point and parameters, gradient (k, q) of the cost.

    root (k, d, q): derivatives of the row's d residuals by the parameters, scaled so that the parameters' own Hessian
    is the sum of root^T root.
    """

    mixed: Floats
    root: Floats
    gradient: Floats

    def subset(self, kept: Bools) -> ParameterEquations:
        """Those of the rows that are kept (k,)."""
        return ParameterEquations(self.mixed[kept], self.root[kept], self.gradient[kept])


class Border(NamedTuple):
    """With the points eliminated: by_pose (n, 6, q), own (q, q), gradient (q,)."""

    by_pose: Floats
    own: Floats
    gradient: Floats


def parameter_equations(terms: Sequence[FreeTerm], free: Ints, p_cam: Floats) -> ParameterEquations:
    """The equations of the `free` parameters (q,) at points p_cam (3, k), with the weights of point_equations."""
    k, q = p_cam.shape[1], len(free)
    mixed, roots, gradient = np.zeros((k, 3, q)), [np.zeros((k, 0, q))], np.zeros((k, q))
    for term in terms:
        residual, by_point = term.linearise(p_cam)
        s = (residual**2).sum(axis=0)
        counts = np.isfinite(s) & (p_cam[2] >= NEAR_M)
        weight, curvature = weight_and_curvature(term.robust.kernel, s, term.robust.scale, len(residual))
        weight = np.where(counts, weight, 0.0)
        share = max(curvature[counts].sum() / max(weight.sum(), 1e-12), LEAST_CURVATURE)
        by_theta = np.where(counts, term.by_parameters(p_cam)[:, free], 0.0).transpose(2, 0, 1)  # (k, d, q)
        by_point = np.where(counts, by_point, 0.0).transpose(2, 1, 0)  # (k, 3, d)
        weighted = weight[:, None, None] * by_theta
        gradient += np.einsum("kdq,dk->kq", weighted, np.where(counts, residual, 0.0))
        mixed += share * (by_point @ weighted)
        roots.append(np.sqrt(share * weight)[:, None, None] * by_theta)
    return ParameterEquations(mixed, np.concatenate(roots, axis=1), gradient)


def border(
    tracks: TrackRows, seen: PointEquations, parameters: ParameterEquations, R: Floats, L: Floats, damping: float
) -> Border:
    """Eliminate the points; R (n, 3, 3) of the poses, L (p, 3, 3) as `reduce_tracks` left it with this damping."""
    length = np.diff(tracks.start)
    track, frame = np.repeat(np.arange(len(length)), length), tracks.frame
    first, full = tracks.start[:-1], length > 0
    R_rows = R[frame]
    W, e = np.zeros((len(length), 3, parameters.mixed.shape[2])), np.zeros((len(length), 3))
    W[full] = np.add.reduceat(R_rows @ parameters.mixed, first[full], axis=0)
    e[full] = np.add.reduceat(np.einsum("kij,kj->ki", R_rows, seen.gradient), first[full], axis=0)
    Z = _solved(L, W)
    own = _summed_products(parameters.root, parameters.root)
    own += np.diag(damping * np.diag(own)) - _summed_products(W, Z)
    gradient = parameters.gradient.sum(axis=0) - np.einsum("pia,pi->a", Z, e)
    rest = parameters.mixed - seen.hessian @ (R_rows.transpose(0, 2, 1) @ Z[track])
    # B^T m = (m x x, -m): the transpose of B = [hat(x) | -I].
    turned = np.cross(rest, seen.p_cam.T[:, :, None], axis=1)
    by_pose = np.zeros((len(R), 6, rest.shape[2]))
    order = np.argsort(frame, kind="stable")
    start = np.searchsorted(frame[order], np.arange(len(R)))
    seeing = np.bincount(frame, minlength=len(R)) > 0
    by_pose[seeing, :3] = np.add.reduceat(turned[order], start[seeing], axis=0)
    by_pose[seeing, 3:] = -np.add.reduceat(rest[order], start[seeing], axis=0)
    return Border(by_pose, own, gradient)


def _summed_products(A: Floats, B: Floats) -> Floats:
    """The sum over k of A_k^T B_k (q, q), of A and B (k, d, q)."""
    k, d, q = A.shape
    return np.asarray(A.reshape(k * d, q).T @ B.reshape(k * d, q), float)


def _solved(L: Floats, W: Floats) -> Floats:
    """V^-1 W (p, 3, q) with V = L L^T; L (p, 3, 3) has the inverses of its diagonal on the diagonal."""
    Z = W.copy()
    for i in range(3):
        for c in range(i):
            Z[:, i] -= L[:, i, c, None] * Z[:, c]
        Z[:, i] *= L[:, i, i, None]
    for i in (2, 1, 0):
        for c in range(i + 1, 3):
            Z[:, i] -= L[:, c, i, None] * Z[:, c]
        Z[:, i] *= L[:, i, i, None]
    return Z
