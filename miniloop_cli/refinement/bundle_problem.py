"""The state of a bundle adjustment: proposals for the descent, and the covariance of the poses at its end."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numpy as np

from miniloop_cli.geometry.se3 import exp_so3, pose
from miniloop_cli.refinement.block_system import BlockSystem
from miniloop_cli.refinement.jackknife import remaining_fraction
from miniloop_cli.refinement.point_equations import PointEquations, point_equations
from miniloop_cli.refinement.pose_equations import add_pose_terms, pose_cost, term_pairs, touched
from miniloop_cli.refinement.schur import reduce_tracks, step_tracks
from miniloop_cli.refinement.terms import PointTerm, PoseTerm
from miniloop_cli.refinement.track_rows import TrackRows, camera_points
from miniloop_cli.runtime.blocks import Blocks
from miniloop_cli.scene.view_graph import components
from miniloop_cli.typing import Bools, Floats, Ints

Part = TypeVar("Part")
_CHUNKS = 8  # fixed, with the bound on their bytes, so that the order of sums does not depend on the number of jobs
_CHUNK_BYTES = 1 << 27
_TIE = 1e-8  # damping of a covariance, so that a direction without measurements is not singular
_LEAST_LEFT = 1e-5  # of the information on a pose: with less, it comes from a single part of the image


def lost(S: Floats, count: int) -> Ints:
    """The first `count` poses whose blocks S (n, 6, 6) are zero: no observation determines them."""
    return np.flatnonzero(~S[:count].any(axis=(1, 2)))


class State(NamedTuple):
    """Poses R (n, 3, 3), t (n, 3), points X (p, 3); the equations of the point terms there; the cost of all terms."""

    R: Floats
    t: Floats
    X: Floats
    seen: PointEquations
    cost: float


class Bundle:
    """Poses and points under point terms and pose terms, and the last proposal.

    R (n, 3, 3), t (n, 3) poses and X (p, 3) points, both relative to `origin` (3,); the rows of the point terms are
    those of `tracks`. `held` (n,): poses that stay.
    """

    def __init__(
        self,
        tracks: TrackRows,
        point_terms: Sequence[PointTerm],
        pose_terms: Sequence[PoseTerm],
        R: Floats,
        t: Floats,
        X: Floats,
        origin: Floats,
        jobs: int,
        least_curvature: float,
        held: Bools | None = None,
    ) -> None:
        self.tracks, self.point_terms, self.pose_terms = tracks, point_terms, pose_terms
        self.origin, self.jobs, self._least_curvature = origin, jobs, least_curvature
        n = len(R)
        pairs = np.concatenate([tracks.pairs(n), term_pairs(pose_terms)])
        self._loose = np.bincount(pairs.ravel(), minlength=n) == 0
        self.system = BlockSystem((self._loose & ~touched(pose_terms, n)) | (False if held is None else held), pairs)
        self.pairs = np.stack([self.system.rows, self.system.cols], axis=1)[n:]
        self._index = self.system.index()
        # The tracks are cut into chunks of equal work (squares of the lengths).
        length = np.diff(tracks.start)
        chunks = int(np.clip(_CHUNK_BYTES // (288 * len(self.system)), 2, _CHUNKS))
        work = np.concatenate([[0], np.cumsum(length * (length + 5))])
        cuts = np.searchsorted(work, work[-1] * np.arange(chunks + 1) / chunks)
        cuts[-1] = len(length)
        self._bounds = list(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True))
        self.state = self._proposal = self.at(R, t, X)

    @property
    def T_world_cam(self) -> Floats:
        """(n, 4, 4) the poses."""
        return pose(self.state.R, self.state.t + self.origin)

    def propose(self, damping: float) -> tuple[float, float]:
        self._proposal = self.state  # free the memory of a rejected proposal
        step, L = self._step(damping)
        self._proposal = self.moved(self.state.seen, step, L)
        return self.state.cost, self._proposal.cost

    def accept(self) -> None:
        self.state = self._proposal

    def _step(self, damping: float) -> tuple[Floats, Floats]:
        """The step of the poses (n, 6), and the factors of the points' blocks as `reduced` gives them."""
        S, g, L = self.reduced(self.tracks, self.state.seen, damping)
        S[lost(S, len(g))] = np.eye(6)  # they stay
        return self.system.solve(S, -g), L

    def reduced(
        self, tracks: TrackRows, seen: PointEquations, damping: float, with_held: bool = False
    ) -> tuple[Floats, Floats, Floats]:
        """Blocks (b, 6, 6) and gradient (n, 6) of the reduced camera system: these rows, and all pose terms.

        The rows leave poses out that are held, unless `with_held`. Also the factors (p, 3, 3) of the points' own
        blocks, from which a step of the poses gives that of the points.
        """
        R, n, L = self.state.R, len(self.state.R), np.zeros((len(self.state.X), 3, 3))
        index = self._index._replace(free=np.ones(n, bool)) if with_held else self._index

        def chunk(low: int, high: int) -> tuple[Floats, Floats]:
            S, g = np.zeros((len(self.system), 6, 6)), np.zeros((n, 6))
            reduce_tracks(low, high, tracks, seen, R, damping, index, S, g, L)
            return S, g

        parts = self._in_chunks(chunk)
        S, g = next(parts)
        for more_S, more_g in parts:
            S += more_S
            g += more_g
        S[:n] = np.triu(S[:n]) + np.triu(S[:n], 1).transpose(0, 2, 1)
        add_pose_terms(self.pose_terms, self.T_world_cam, self._loose, damping, self.system, S, g)
        return S, g, L

    def covariance(self, anchor: Ints, part: Ints) -> Floats:
        """(n, 6, 6) marginal covariances of the poses at a minimum, given the anchors of their groups (n,).

        Variances are those of the grouped jackknife, by one Newton step without each part (k,): see jackknife.py.
        Correlations are those of the inverse Hessian, as the parts are too few to estimate them. Variances are at least
        the share of its own that pose terms have in the information. Infinite for poses that at most one part of the
        image determines or joins to their anchor.
        """
        self._proposal = self.state  # frees the memory of an earlier one
        held = anchor == np.arange(len(anchor))
        system, n = BlockSystem(held, self.pairs), len(held)
        H = self.reduced(self.tracks, self.state.seen, _TIE, with_held=True)[0]
        unknown = np.zeros(n, bool)
        unknown[lost(H, n)] = True
        H[:n][unknown] = np.eye(6)
        inverse, own = system.marginals(H), H[:n].copy()
        del H  # hundreds of megabytes for a long recording
        diagonal, variance = np.einsum("nii->ni", own), np.zeros((n, 6))

        def without(number: int) -> tuple[Floats, Bools]:
            """The step (n, 6) of the poses without a part, and which are unknown then (n,)."""
            with self.state.seen.silent(np.flatnonzero(part == number)) as seen:
                S, g, _ = self.reduced(self.tracks, seen, _TIE, with_held=True)
            gone = (np.einsum("nii->ni", S[:n]) < _LEAST_LEFT * diagonal).any(axis=1)
            S[:n][gone], g[gone] = own[gone], 0.0
            group = components(n, self.pairs[S[n:].any(axis=(1, 2))])
            return system.solve(S, -g), gone | (group != group[anchor])

        for number, left in enumerate(remaining_fraction(part)):
            step, missing = without(number)
            variance += left * step**2
            unknown |= missing
        # Pose terms stay when a part of the image is left out: what they leave open is in the inverse, by their share.
        scale = np.where(held[:, None], 1.0, np.einsum("nii->ni", inverse))
        size = np.sqrt(np.maximum(variance / scale, self._share_of_terms(diagonal)))
        found = size[:, :, None] * inverse * size[:, None, :]
        found[unknown & ~held] = np.diag(np.full(6, np.inf))
        return found

    def _share_of_terms(self, diagonal: Floats) -> Floats:
        """(n, 6) the share of the pose terms in the information, whose `diagonal` (n, 6) has all terms."""
        S, g = np.zeros((len(self.system), 6, 6)), np.zeros_like(diagonal)
        add_pose_terms(self.pose_terms, self.T_world_cam, self._loose, _TIE, self.system, S, g)
        return np.clip(np.einsum("nii->ni", S[: len(g)]) / diagonal, 0.0, 1.0)

    def at(self, R: Floats, t: Floats, X: Floats) -> State:
        """The state of these poses and points."""
        p_cam = camera_points(self.tracks, R, t, X)
        with Blocks(self.jobs) as blocks:
            seen, cost = point_equations(self.point_terms, p_cam, self._least_curvature, blocks)
        return State(R, t, X, seen, cost + pose_cost(self.pose_terms, pose(R, t + self.origin)))

    def moved(self, seen: PointEquations, step: Floats, L: Floats) -> State:
        """After the pose step (n, 6) and the corresponding step of the points; L (p, 3, 3) from `reduced`."""
        R, t, X, _, _ = self.state
        X_new = X.copy()

        def chunk(low: int, high: int) -> None:
            step_tracks(low, high, self.tracks, seen, R, L, step, X_new)

        list(self._in_chunks(chunk))
        R_new = np.ascontiguousarray(R @ exp_so3(step[:, :3]))
        return self.at(R_new, t + np.einsum("nij,nj->ni", R, step[:, 3:]), X_new)

    def _in_chunks(self, work: Callable[[int, int], Part]) -> Iterator[Part]:
        """The results of `work` for each chunk of tracks, in order; each is freed once it is consumed.

        At most `jobs` chunks are in work or wait to be consumed, as each can hold hundreds of megabytes.
        """
        if self.jobs == 1:
            yield from (work(low, high) for low, high in self._bounds)
            return
        ahead = deque[Future[Part]]()
        with ThreadPoolExecutor(self.jobs) as pool:
            for low, high in self._bounds:
                if len(ahead) == self.jobs:
                    yield ahead.popleft().result()
                ahead.append(pool.submit(work, low, high))
            while ahead:
                yield ahead.popleft().result()
