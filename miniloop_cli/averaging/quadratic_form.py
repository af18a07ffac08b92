"""The pose graph as one quadratic form, for the proof of its optimum.

With Y_i = [R_i t_i] (3, 4) and relative poses T_j_i (4, 4) the cost of all edges is
  f(Y) = sum_e tr((Y_i - Y_j T_j_i) W_e (Y_i - Y_j T_j_i)') = tr(Y Q Y'),   W_e = kappa_e diag(1, 1, 1, 0) + tau_e c c',
which compares rotations, and the positions of one point c = (c_i, 1) of scan i: the middle of the edge's matches, where
errors of rotation and translation are nearly independent. Q is sparse, and the translations can be eliminated exactly
(Rosen, Carlone, Bandeira & Leonard, "SE-Sync", IJRR 2019, where c is the camera's centre).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.scene.view_graph import elimination_order
from miniloop_cli.typing import Floats, Ints

WEIGHT_RANGE = 1e8  # weights smaller than the largest by more are raised, as the equations would lose digits


@dataclass(frozen=True)
class EdgeWeights:
    """Isotropic weights of m edges: kappa (m,) 1/rad^2 halved, tau (m,) 1/m^2, about points c_i (m, 3) m of scan i.

    |R_j R_j_i - R_i|^2 is 2 angle^2 for small angles, hence the half.
    """

    kappa: Floats
    tau: Floats
    c_i: Floats

    @staticmethod
    def of(T_j_i: Floats, information: Floats) -> EdgeWeights:
        """The weights with the traces of the covariances of the information matrices (m, 6, 6), as in Edge.

        [exp(w) | v] T_j_i moves a point c_j by v - c_j x w; at the middle of the matches this is independent of w.
        """
        H = information
        lever = np.linalg.pinv(H[:, 3:, 3:], hermitian=True) @ H[:, 3:, :3]  # v = -lever w, of the best v for a given w
        skew = (np.swapaxes(lever, 1, 2) - lever) / 2
        c_j = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
        c_i = se3.transform(se3.inverse(T_j_i), c_j[:, None])[:, 0]
        of_rotation = H[:, :3, :3] - np.swapaxes(H[:, 3:, :3], 1, 2) @ lever
        return EdgeWeights(_trace_equivalent(of_rotation) / 2, _trace_equivalent(H[:, 3:, 3:]), c_i)

    def times(self, rotation: Floats, translation: Floats) -> EdgeWeights:
        """The weights times further weights `rotation` and `translation` (m,), as of a robust kernel."""
        return EdgeWeights(_bounded(self.kappa * rotation), _bounded(self.tau * translation), self.c_i)


def _trace_equivalent(information: Floats) -> Floats:
    values = np.linalg.eigvalsh(information)
    return 3.0 / (1 / np.maximum(values, np.maximum(values[:, -1:] / WEIGHT_RANGE, 1e-300))).sum(axis=1)


def _bounded(weights: Floats) -> Floats:
    return np.maximum(weights, weights.max(initial=0.0) / WEIGHT_RANGE)


@dataclass(frozen=True)
class QuadraticForm:
    """Q (4n, 4n) sparse, of n scans in an order that keeps its factors sparse.

    `order` (n,): the scan in each place. Y is kept as (n, 4, r): block i is Y_i' with Y_i (r, 4), r = 3 or more.
    """

    Q: Any
    order: Ints
    kappa_sum: float

    @staticmethod
    def of(count: int, pairs: Ints, T_j_i: Floats, weights: EdgeWeights) -> QuadraticForm:
        """The form of a connected graph of `count` scans, pairs (m, 2) rows (i, j), T_j_i (m, 4, 4)."""
        from scipy.sparse import coo_array

        order = elimination_order(count, pairs)
        place = np.empty(count, np.int64)
        place[order] = np.arange(count)
        i, j = place[pairs].T
        c = np.concatenate([weights.c_i, np.ones((len(pairs), 1))], axis=1)
        W = weights.tau[:, None, None] * c[:, :, None] * c[:, None, :]
        W[:, [0, 1, 2], [0, 1, 2]] += weights.kappa[:, None]
        TW = T_j_i @ W
        own = np.zeros((count, 4, 4))
        np.add.at(own, i, W)
        np.add.at(own, j, TW @ np.swapaxes(T_j_i, 1, 2))
        blocks = np.concatenate([own, -TW, -np.swapaxes(TW, 1, 2)])
        rows = np.concatenate([np.arange(count), j, i])[:, None, None] * 4 + np.arange(4)[:, None]
        columns = np.concatenate([np.arange(count), i, j])[:, None, None] * 4 + np.arange(4)
        ends = (np.broadcast_to(x, blocks.shape).ravel() for x in (rows, columns))
        Q = coo_array((blocks.ravel(), tuple(ends)), shape=(4 * count, 4 * count)).tocsr()
        return QuadraticForm(Q, order, float(weights.kappa.sum()))

    @property
    def count(self) -> int:
        """n, the scans."""
        return len(self.order)

    def rows(self, T_world_cam: Floats) -> Floats:
        """Y (n, 4, 3) of poses (n, 4, 4)."""
        return np.ascontiguousarray(np.swapaxes(T_world_cam[self.order, :3], 1, 2))

    def poses(self, Y: Floats) -> Floats:
        """T_world_cam (n, 4, 4) of Y (n, 4, 3)."""
        T = np.empty((self.count, 4, 4))
        T[self.order] = se3.pose(np.swapaxes(Y[:, :3], 1, 2), Y[:, 3])
        return T

    def times(self, Y: Floats) -> Floats:
        """Q Y, (n, 4, r)."""
        return (self.Q @ Y.reshape(len(Y) * 4, -1)).reshape(Y.shape)

    def factor(self, multipliers: Floats | None = None, shift: float = 0.0) -> Factor:
        """Factor of Q - blockdiag(multipliers) + shift on the rotations; multipliers (n, 3, 3).

        A weight on the first translation fixes the origin, which does not change f.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.linalg import splu

        n = self.count
        blocks = np.zeros((n, 3, 3)) if multipliers is None else -multipliers
        blocks[:, [0, 1, 2], [0, 1, 2]] += shift
        first = 4 * np.arange(n)[:, None, None]
        ends = tuple(np.broadcast_to(first + k, blocks.shape).ravel() for k in (np.arange(3)[:, None], np.arange(3)))
        origin = coo_array(([self.Q.diagonal()[3]], ([3], [3])), shape=self.Q.shape)
        shifted = self.Q + coo_array((blocks.ravel(), ends), shape=self.Q.shape) + origin
        symmetric = {"SymmetricMode": True, "Equil": False}
        return Factor(splu(shifted.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0, options=symmetric))


@dataclass(frozen=True)
class Factor:
    """L U of a symmetric matrix with diagonal pivots, whose signs are those of the eigenvalues."""

    lu: Any

    @property
    def definite(self) -> bool:
        """Whether all eigenvalues are positive (Sylvester's law of inertia)."""
        kept = np.array_equal(self.lu.perm_r, np.arange(len(self.lu.perm_r)))
        return bool(kept and (self.lu.U.diagonal() > 0).all())

    def solve(self, Z: Floats) -> Floats:
        """The inverse times Z (n, 4, r)."""
        return self.lu.solve(np.ascontiguousarray(Z.reshape(len(Z) * 4, -1))).reshape(Z.shape)
