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
from miniloop_cli.runtime.kernels import njit
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
    q = parameters.mixed.shape[2]
    W, Z, e = np.zeros((len(L), 3, q)), np.zeros((len(L), 3, q)), np.zeros((len(L), 3))
    by_pose = np.zeros((len(R), 6, q))
    _eliminate(tracks, seen, parameters.mixed, R, L, W, Z, e, by_pose)
    own = _summed_products(parameters.root, parameters.root)
    own += np.diag(damping * np.diag(own)) - _summed_products(W, Z)
    return Border(by_pose, own, parameters.gradient.sum(axis=0) - np.einsum("pia,pi->a", Z, e))


def _summed_products(A: Floats, B: Floats) -> Floats:
    """The sum over k of A_k^T B_k (q, q), of A and B (k, d, q)."""
    k, d, q = A.shape
    return np.asarray(A.reshape(k * d, q).T @ B.reshape(k * d, q), float)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def _eliminate(
    tracks: TrackRows,
    seen: PointEquations,
    mixed: Floats,
    R: Floats,
    L: Floats,
    W: Floats,
    Z: Floats,
    e: Floats,
    by_pose: Floats,
) -> None:
    """Fill W, Z (p, 3, q), the gradients e (p, 3) of the points, and by_pose (n, 6, q), which are all 0 before.

    mixed (k, 3, q); L (p, 3, 3) has the inverses of its diagonal on the diagonal, V = L L^T.
    """
    q = mixed.shape[2]
    z, m = np.empty(3), np.empty(3)
    for p in range(len(L)):
        rows = range(tracks.start[p], tracks.start[p + 1])
        if len(rows) == 0:
            continue
        for k in rows:
            f = tracks.frame[k]
            for i in range(3):
                for c in range(3):
                    e[p, i] += R[f, i, c] * seen.gradient[k, c]
                    for a in range(q):
                        W[p, i, a] += R[f, i, c] * mixed[k, c, a]
        for a in range(q):
            for i in range(3):
                Z[p, i, a] = W[p, i, a]
                for c in range(i):
                    Z[p, i, a] -= L[p, i, c] * Z[p, c, a]
                Z[p, i, a] *= L[p, i, i]
            for i in range(2, -1, -1):
                for c in range(i + 1, 3):
                    Z[p, i, a] -= L[p, c, i] * Z[p, c, a]
                Z[p, i, a] *= L[p, i, i]
        for k in rows:
            f, A = tracks.frame[k], seen.hessian[k]
            for a in range(q):
                for c in range(3):
                    z[c] = R[f, 0, c] * Z[p, 0, a] + R[f, 1, c] * Z[p, 1, a] + R[f, 2, c] * Z[p, 2, a]
                for i in range(3):
                    m[i] = mixed[k, i, a] - (A[i, 0] * z[0] + A[i, 1] * z[1] + A[i, 2] * z[2])
                # B^T m = (m x x, -m): the transpose of B = [hat(x) | -I].
                for i in range(3):
                    u, v = (i + 1) % 3, (i + 2) % 3
                    by_pose[f, i, a] += m[u] * seen.p_cam[v, k] - m[v] * seen.p_cam[u, k]
                    by_pose[f, 3 + i, a] -= m[i]
