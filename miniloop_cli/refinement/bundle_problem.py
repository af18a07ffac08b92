"""The state of a bundle adjustment: what the descent asks for, and the covariance of the poses at its end."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.geometry.se3 import exp_so3
from miniloop_cli.refinement.block_system import BlockSystem
from miniloop_cli.refinement.edge_terms import Edges, add_edges, evaluate_edges
from miniloop_cli.refinement.noise_terms import add_noise, point_leverage
from miniloop_cli.refinement.robust import NAMES, weight_and_curvature
from miniloop_cli.refinement.schur import reduce_tracks, step_tracks
from miniloop_cli.refinement.track_terms import Model, Observations, evaluate_tracks, mark_seen_together

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Part = TypeVar("Part")
_CHUNKS = 8  # with the bound on their bytes this fixes how sums are ordered, whatever the number of jobs
_CHUNK_BYTES = 1 << 28
_LEAST_CURVATURE = 0.25  # of the weights' own: where residuals are large, the kernels' is no guide
_TIE = (
    1e-8  # relative prior of a pose in its covariance: a direction that nothing measures comes out huge, not singular
)


def lost(S: Array, count: int) -> Ints:
    """Poses, whose blocks are the first `count`, that lie where none of their observations says anything."""
    return np.flatnonzero(~S[:count].any(axis=(1, 2)))


class Bundle:
    """Poses R (n, 3, 3), t (n, 3), points X (p, 3), and the last proposal."""

    def __init__(self, obs: Observations, model: Model, R: Array, t: Array, X: Array, edges: Edges, jobs: int) -> None:
        self.obs, self.model, self.edges, self.R, self.t, self.X, self.jobs = obs, model, edges, R, t, X, jobs
        n = len(R)
        together = np.zeros((n, n), bool)
        mark_seen_together(obs, together)
        self.pairs = np.concatenate([np.argwhere(together), edges.pairs])
        self.idle = np.bincount(self.pairs.ravel(), minlength=n) == 0
        self.system = BlockSystem(self.idle, self.pairs)
        self._has_edges = len(edges.i) > 0  # without them their kernels need not be compiled
        self._table, self._block = self.system.table(), self.system.block_of(edges.i, edges.j)
        # Tracks are cut where the work (the square of the length) is even.
        length = np.diff(obs.start)
        chunks = int(np.clip(_CHUNK_BYTES // (288 * len(self.system)), 2, _CHUNKS))
        work = np.concatenate([[0], np.cumsum(length * (length + 5))])
        cuts = np.searchsorted(work, work[-1] * np.arange(chunks + 1) / chunks)
        cuts[-1] = len(length)
        self._bounds = list(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True))
        self._proposal = (R, t, X)

    def propose(self, damping: float) -> tuple[float, float]:
        model = self._stepping()
        S, g, cost = self.reduced(model, damping)
        S[lost(S, len(g))] = np.eye(6)  # they stay
        return cost, self._move(model, self.system.solve(S, -g), damping)

    def accept(self) -> None:
        self.R, self.t, self.X = self._proposal

    def reduced(self, model: Model, damping: float) -> tuple[Array, Array, float]:
        """Blocks (b, 6, 6) and gradient (n, 6) of the reduced camera system, and the cost."""

        def chunk(low: int, high: int) -> tuple[Array, Array, float]:
            S, g = np.zeros((len(self.system), 6, 6)), np.zeros((len(self.R), 6))
            state = (self.R, self.t, self.X)
            return S, g, reduce_tracks(low, high, self.obs, model, *state, damping, self._table, S, g)

        parts = self._in_chunks(chunk)
        S, g, cost = parts[0]
        for more_S, more_g, more_cost in parts[1:]:
            S, g, cost = S + more_S, g + more_g, cost + more_cost
        self._mirror(S)
        return S, g, cost + self._add_edges(damping, S, g)

    def evaluate(self) -> tuple[Array, Array]:
        """Whitened residuals (k, 3) and robust weights (k, 2) of all observations."""
        residual, weight = np.empty((len(self.obs.frame), 3)), np.empty((len(self.obs.frame), 2))
        evaluate_tracks(self.obs, self.model, self.R, self.t, self.X, residual, weight)
        return residual, weight

    def covariance(self, held: NDArray[np.bool_]) -> Array:
        """(n, 6, 6) marginal covariances of the poses at a minimum, given the held ones.

        H^-1 B H^-1 with H the reduced Hessian by the mean curvature of the kernels, and B what the noise does to its
        gradient (Huber 1967; White 1982). The size of the noise is taken from the residuals, one factor for
        all pixels and one for all depths, so that it holds whatever the settings assumed of it; that residuals are
        independent is assumed. The diagonal blocks of the product are the derivative of those of (H - e B)^-1 by e:
        two selected inverses, no column is ever solved for. Infinite for poses of which no observation is left.
        """
        bread, noise = self._spread(6 * np.count_nonzero(~held))
        H = self.reduced(bread, 0.0)[0]
        unknown = np.setdiff1d(lost(H, len(held)), np.flatnonzero(held))
        H[unknown] = np.eye(6)
        B = np.zeros_like(H)
        add_noise(self.obs, bread, noise, self.R, self.t, self.X, self._table, B)
        self._mirror(B)
        self._add_edges(0.0, B, np.zeros((len(self.R), 6)))
        free, d = np.flatnonzero(~held)[:, None], np.arange(6)
        ratio = np.max(B[free, d, d] / H[free, d, d], initial=1e-12)
        tie = _TIE * H[free, d, d]
        H[free, d, d] += tie
        B[free, d, d] += ratio * tie
        system, step = BlockSystem(held, self.pairs), 1e-3 / ratio
        found = (system.marginals(H - step * B) - system.marginals(H + step * B)) / (2 * step)
        found[unknown] = np.diag(np.full(6, np.inf))
        return found

    def _stepping(self) -> Model:
        """The model whose Hessian has the kernels' mean curvature here.

        Steps by the weights alone (iteratively reweighted least squares) fall short by a quarter to a half, each time.
        """
        share = []
        for s, scale, dimension in self._squares():
            weight, curvature = weight_and_curvature(NAMES[self.model.kind], s, scale, dimension)
            share.append(max(curvature.sum() / max(weight.sum(), 1e-12), _LEAST_CURVATURE))
        return self.model._replace(curvature_px=float(share[0]), curvature_depth=float(share[1]))

    def _squares(self) -> tuple[tuple[Array, float, int], tuple[Array, float, int]]:
        """Squared residuals in sigmas, scale of the kernel and dimension: of the pixels, and of the depths."""
        residual = self.evaluate()[0]
        seen = np.isfinite(residual[:, 0])
        px2 = (residual[seen, :2] ** 2).sum(axis=1)
        z2 = residual[seen & (self.obs.inverse_sigma_z > 0), 2] ** 2
        return (px2, self.model.c2_px**0.5, 2), (z2, self.model.c2_depth**0.5, 1)

    def _spread(self, pose_freedoms: int) -> tuple[Model, Model]:
        """Models whose Hessians are the curvature of the cost, and the variance of its gradient."""
        squares, state, model = self._squares(), (self.R, self.t, self.X), self.model
        only_px, only_z = model._replace(curvature_depth=0.0), model._replace(curvature_px=0.0)
        absorbed = [point_leverage(self.obs, model, part, *state) for part in (only_px, only_z)]
        sizes = [dimension * len(s) for s, _, dimension in squares]
        left = sum(sizes) - sum(absorbed)
        poses = max(left - pose_freedoms, 1.0) / max(left, 1.0)
        found = []
        for (s, scale, dimension), size, taken in zip(squares, sizes, absorbed, strict=True):
            # The fit has shrunk the residuals; the errors were larger by what it took.
            error2 = s / (max(size - taken, 1.0) / max(size, 1) * poses)
            total = max(weight_and_curvature(NAMES[model.kind], s, scale, dimension)[0].sum(), 1e-12)
            weight, curvature = weight_and_curvature(NAMES[model.kind], error2, scale, dimension)
            found.append((max(curvature.sum() / total, 0.1), weight**2 @ error2 / (dimension * total)))
        (px_curvature, px_variance), (z_curvature, z_variance) = found
        return (
            model._replace(curvature_px=float(px_curvature), curvature_depth=float(z_curvature)),
            model._replace(curvature_px=float(px_variance), curvature_depth=float(z_variance)),
        )

    def _move(self, model: Model, step: Array, damping: float) -> float:
        """Propose the pose step (n, 6) and the points that go with it; their cost."""
        R = np.ascontiguousarray(self.R @ exp_so3(step[:, :3]))
        t, X = self.t + np.einsum("nij,nj->ni", self.R, step[:, 3:]), self.X.copy()
        self._proposal = (R, t, X)

        def chunk(low: int, high: int) -> float:
            old = (self.R, self.t, self.X)
            return step_tracks(low, high, self.obs, model, *old, damping, step, R, t, X)

        cost = sum(self._in_chunks(chunk))
        return cost + evaluate_edges(self.edges, R, t, *np.empty((2, len(self.edges.i)))) if self._has_edges else cost

    def _add_edges(self, damping: float, S: Array, g: Array) -> float:
        return add_edges(self.edges, self._block, self.R, self.t, damping, S, g) if self._has_edges else 0.0

    def _mirror(self, S: Array) -> None:
        diagonal = S[: len(self.R)]
        diagonal[:] = np.triu(diagonal) + np.triu(diagonal, 1).transpose(0, 2, 1)

    def _in_chunks(self, work: Callable[[int, int], Part]) -> list[Part]:
        if self.jobs == 1:
            return [work(low, high) for low, high in self._bounds]
        with ThreadPoolExecutor(self.jobs) as pool:
            return list(pool.map(lambda bounds: work(*bounds), self._bounds))
