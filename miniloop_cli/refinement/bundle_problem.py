"""The state of a bundle adjustment: what the descent asks for, and the covariance of the poses at its end."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from miniloop_cli.geometry.se3 import exp_so3
from miniloop_cli.refinement.block_system import BlockSystem
from miniloop_cli.refinement.jackknife import remaining_fraction
from miniloop_cli.refinement.robust import NAMES, weight_and_curvature
from miniloop_cli.refinement.schur import reduce_tracks, step_tracks
from miniloop_cli.refinement.track_terms import Model, Observations, evaluate_tracks, mark_seen_together
from miniloop_cli.scene.view_graph import components
from miniloop_cli.typing import Bools, Floats, Ints

Part = TypeVar("Part")
_CHUNKS = 8  # with the bound on their bytes this fixes how sums are ordered, whatever the number of jobs
_CHUNK_BYTES = 1 << 28
_LEAST_CURVATURE = 0.25  # of the weights' own: where residuals are large, the kernels' is no guide
_TIE = 1e-8  # damping of a covariance: a direction that nothing measures must not be singular
_LEAST_LEFT = 1e-5  # of what is known of a pose: with less, a single part of the image tells of it


def lost(S: Floats, count: int) -> Ints:
    """Poses, whose blocks are the first `count`, that lie where none of their observations says anything."""
    return np.flatnonzero(~S[:count].any(axis=(1, 2)))


def _subset(obs: Observations, kept: Bools) -> Observations:
    """The observations that are kept (k,); a track may have none left."""
    start = np.concatenate([np.zeros(1, np.int64), np.cumsum(kept)])[obs.start]
    return Observations(start, *(column[kept] for column in obs[1:]))


class Bundle:
    """Poses R (n, 3, 3), t (n, 3), points X (p, 3), and the last proposal."""

    def __init__(self, obs: Observations, model: Model, R: Floats, t: Floats, X: Floats, jobs: int) -> None:
        self.obs, self.model, self.R, self.t, self.X, self.jobs = obs, model, R, t, X, jobs
        n = len(R)
        together = np.zeros((n, n), bool)
        mark_seen_together(obs, together)
        self.pairs = np.argwhere(together)
        self.idle = np.bincount(self.pairs.ravel(), minlength=n) == 0
        self.system = BlockSystem(self.idle, self.pairs)
        self._table = self.system.table()
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
        S, g, cost = self.reduced(self.obs, model, damping)
        S[lost(S, len(g))] = np.eye(6)  # they stay
        return cost, self._move(model, self.system.solve(S, -g), damping)

    def accept(self) -> None:
        self.R, self.t, self.X = self._proposal

    def reduced(self, obs: Observations, model: Model, damping: float) -> tuple[Floats, Floats, float]:
        """Blocks (b, 6, 6) and gradient (n, 6) of the reduced camera system, and the cost, of all or part of `obs`."""

        def chunk(low: int, high: int) -> tuple[Floats, Floats, float]:
            S, g = np.zeros((len(self.system), 6, 6)), np.zeros((len(self.R), 6))
            state = (self.R, self.t, self.X)
            return S, g, reduce_tracks(low, high, obs, model, *state, damping, self._table, S, g)

        parts = self._in_chunks(chunk)
        S, g, cost = parts[0]
        for more_S, more_g, more_cost in parts[1:]:
            S, g, cost = S + more_S, g + more_g, cost + more_cost
        self._mirror(S)
        return S, g, cost

    def evaluate(self) -> tuple[Floats, Floats]:
        """Whitened residuals (k, 3) and robust weights (k, 2) of all observations."""
        residual, weight = np.empty((len(self.obs.frame), 3)), np.empty((len(self.obs.frame), 2))
        evaluate_tracks(self.obs, self.model, self.R, self.t, self.X, residual, weight)
        return residual, weight

    def covariance(self, anchor: Ints, part: Ints) -> Floats:
        """(n, 6, 6) marginal covariances of the poses at a minimum, given the anchors of their groups (n,).

        Variances are those of the grouped jackknife, by one Newton step without each part (k,): see parts.py.
        Correlations are those of the inverse Hessian, as the parts are too few to tell them. Infinite for poses that
        nothing, or a single part, tells of or ties to their anchor.
        """
        held = anchor == np.arange(len(anchor))
        model, system, n = self._stepping(), BlockSystem(held, self.pairs), len(held)
        H = self.reduced(self.obs, model, _TIE)[0]
        unknown = np.zeros(n, bool)
        unknown[lost(H, n)] = True
        H[:n][unknown] = np.eye(6)
        diagonal, variance = np.einsum("nii->ni", H[:n]), np.zeros((n, 6))
        for number, left in enumerate(remaining_fraction(part)):
            S, g, _ = self.reduced(_subset(self.obs, part != number), model, _TIE)
            gone = (np.einsum("nii->ni", S[:n]) < _LEAST_LEFT * diagonal).any(axis=1)
            S[:n][gone], g[gone] = H[:n][gone], 0.0
            group = components(n, self.pairs[S[n:].any(axis=(1, 2))])
            unknown |= gone | (group != group[anchor])
            variance += left * system.solve(S, -g) ** 2
        inverse = system.marginals(H)
        size = np.sqrt(variance / np.where(held[:, None], 1.0, np.einsum("nii->ni", inverse)))
        found = size[:, :, None] * inverse * size[:, None, :]
        found[unknown & ~held] = np.diag(np.full(6, np.inf))
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

    def _squares(self) -> tuple[tuple[Floats, float, int], tuple[Floats, float, int]]:
        """Squared residuals in sigmas, scale of the kernel and dimension: of the pixels, and of the depths."""
        residual = self.evaluate()[0]
        seen = np.isfinite(residual[:, 0])
        px2 = (residual[seen, :2] ** 2).sum(axis=1)
        z2 = residual[seen & (self.obs.inverse_sigma_z > 0), 2] ** 2
        return (px2, self.model.c2_px**0.5, 2), (z2, self.model.c2_depth**0.5, 1)

    def _move(self, model: Model, step: Floats, damping: float) -> float:
        """Propose the pose step (n, 6) and the points that go with it; their cost."""
        R = np.ascontiguousarray(self.R @ exp_so3(step[:, :3]))
        t, X = self.t + np.einsum("nij,nj->ni", self.R, step[:, 3:]), self.X.copy()
        self._proposal = (R, t, X)

        def chunk(low: int, high: int) -> float:
            old = (self.R, self.t, self.X)
            return step_tracks(low, high, self.obs, model, *old, damping, step, R, t, X)

        return sum(self._in_chunks(chunk))

    def _mirror(self, S: Floats) -> None:
        diagonal = S[: len(self.R)]
        diagonal[:] = np.triu(diagonal) + np.triu(diagonal, 1).transpose(0, 2, 1)

    def _in_chunks(self, work: Callable[[int, int], Part]) -> list[Part]:
        if self.jobs == 1:
            return [work(low, high) for low, high in self._bounds]
        with ThreadPoolExecutor(self.jobs) as pool:
            return list(pool.map(lambda bounds: work(*bounds), self._bounds))
