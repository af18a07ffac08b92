"""Bundle adjustment of RGB-D tracks: all poses and points at once, with the intrinsics fixed.

Every observation gives a pixel residual (2, in units of `sigma_px`, the same for all image scales) and, where depth
was measured, a depth residual (z_predicted - z_measured) / (depth_sigma_factor sigma_z(z_measured)), each under its own
robust kernel. Levenberg-Marquardt with the points eliminated by the Schur complement.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from miniloop_cli.geometry.se3 import exp_so3, pose, project_so3
from miniloop_cli.refinement.block_system import BlockSystem
from miniloop_cli.refinement.lm import Descent, minimise
from miniloop_cli.refinement.points import initial_points
from miniloop_cli.refinement.robust import KERNELS, Kernel
from miniloop_cli.refinement.schur import reduce_tracks, step_tracks
from miniloop_cli.refinement.track_terms import Model, Observations, evaluate_tracks, mark_seen_together
from miniloop_cli.scans.camera import Camera

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Part = TypeVar("Part")
_CHUNK_BYTES = 1 << 28  # of partial sums; with the most chunks below it fixes how sums are ordered, whatever `jobs` is
_CHUNKS = 8


@dataclass(frozen=True)
class BundleSettings:
    """Noise (`sigma_px` in pixels; depth as a multiple of the sensor model), kernels (scales in sigmas), stopping."""

    sigma_px: float = 1.0
    depth_sigma_factor: float = 4.0
    kernel: Kernel = "cauchy"
    scale_px: float = 2.0
    scale_depth: float = 2.0
    max_iterations: int = 30
    relative_tolerance: float = 1e-5
    fixed_frame: int | None = None  # the gauge; by default the frame with the most observations


@dataclass(frozen=True)
class BundleResult:
    """What came out. `used` (k,) bool: the observation took part. Residuals are in sigmas, NaN where there is none."""

    T_world_cam: Array
    points_world: Array
    used: NDArray[np.bool_]
    residual_px: Array
    residual_depth: Array
    weight_px: Array
    weight_depth: Array
    fixed_frame: int
    descent: Descent


def bundle_adjust(
    T_world_cam: Array,
    frame: ArrayLike,
    track: ArrayLike,
    px_ideal: Array,
    z_m: Array,
    camera: Camera,
    settings: BundleSettings | None = None,
    jobs: int = 1,
) -> BundleResult:
    """Refine poses (n, 4, 4) and the points of tracks.

    frame, track (k,) ints; px_ideal (k, 2) undistorted pixels; z_m (k,) depth in metres, NaN where none was measured.
    `jobs` threads change the time, not one bit of the result.
    A frame without observations keeps its pose. A track seen once, or whose rays leave its depth open, does not take
    part and its point is NaN.
    Raises ValueError for shapes that do not fit, numbers that are not finite, or a frame twice in a track.
    """
    settings = settings or BundleSettings()
    T, frame, track, px, z = _checked(T_world_cam, frame, track, px_ideal, z_m)
    n = len(T)
    # Sums of large coordinates would cost digits: work relative to the mean camera.
    origin = T[:, :3, 3].mean(axis=0)
    R, t = np.ascontiguousarray(project_so3(T[:, :3, :3])), T[:, :3, 3] - origin

    order = np.lexsort((frame, track))
    frame, track, px, z = frame[order], track[order], px[order], z[order]
    if np.any((np.diff(frame) == 0) & (np.diff(track) == 0)):
        raise ValueError("a track sees the same frame twice")
    n_tracks = int(track.max()) + 1 if len(track) else 0
    X, good = initial_points(R, t, frame, track, n_tracks, px, z, camera)
    used = good[track]
    counts = np.bincount(frame[used], minlength=n)
    fixed_frame = int(np.argmax(counts)) if settings.fixed_frame is None else settings.fixed_frame

    obs, model = _kernel_inputs(frame[used], track[used], n_tracks, px[used], z[used], camera, settings)
    problem = _Bundle(obs, model, R, t, X, fixed_frame, jobs)
    descent = minimise(problem, settings.max_iterations, settings.relative_tolerance)

    residual, weight = np.full((len(order), 3), np.nan), np.zeros((len(order), 2))
    back = order[used]
    residual[back], weight[back] = problem.evaluate()
    no_depth = ~np.isfinite(np.asarray(z_m, float).reshape(-1))
    residual[no_depth, 2], weight[no_depth, 1] = np.nan, 0.0
    taken = np.zeros(len(order), bool)
    taken[back] = True
    T_new = T.copy()
    moved = counts > 0
    T_new[moved] = pose(problem.R, problem.t + origin)[moved]
    points = np.where(good[:, None], problem.X + origin, np.nan)
    return BundleResult(
        T_new, points, taken, residual[:, :2], residual[:, 2], weight[:, 0], weight[:, 1], fixed_frame, descent
    )


class _Bundle:
    """The state of the descent: poses, points, and the last proposal."""

    def __init__(
        self, obs: Observations, model: Model, R: Array, t: Array, X: Array, fixed_frame: int, jobs: int
    ) -> None:
        self.obs, self.model, self.R, self.t, self.X, self.jobs = obs, model, R, t, X, jobs
        n = len(R)
        fixed = np.bincount(obs.frame, minlength=n) == 0
        fixed[fixed_frame] = True
        self.system = BlockSystem(fixed, _seen_together(obs, n))
        self.table = self.system.table()
        # Tracks are cut where the work (the square of the length) is even.
        length = np.diff(obs.start)
        chunks = int(np.clip(_CHUNK_BYTES // (288 * len(self.system)), 1, _CHUNKS))
        work = np.concatenate([[0], np.cumsum(length * (length + 5))])
        self.cuts = np.searchsorted(work, work[-1] * np.arange(chunks + 1) / chunks)
        self.cuts[-1] = len(length)
        self._proposal = (R, t, X)

    def propose(self, damping: float) -> tuple[float, float]:
        S, g, cost = self.reduced(damping)
        step = self.system.factor(S).solve(-g)
        R, t, X = self.R @ exp_so3(step[:, :3]), self.t + np.einsum("nij,nj->ni", self.R, step[:, 3:]), self.X.copy()
        self._proposal = (R, t, X)

        def chunk(low: int, high: int) -> float:
            old = (self.R, self.t, self.X)
            return step_tracks(low, high, self.obs, self.model, *old, damping, step, R, t, X)

        return cost, sum(self._chunks(chunk))

    def accept(self) -> None:
        R, self.t, self.X = self._proposal
        self.R = np.ascontiguousarray(R)

    def reduced(self, damping: float) -> tuple[Array, Array, float]:
        """Blocks (b, 6, 6) and gradient (n, 6) of the reduced camera system, and the cost."""

        def chunk(low: int, high: int) -> tuple[Array, Array, float]:
            S, g = np.zeros((len(self.system), 6, 6)), np.zeros((len(self.R), 6))
            state = (self.R, self.t, self.X)
            return S, g, reduce_tracks(low, high, self.obs, self.model, *state, damping, self.table, S, g)

        parts = self._chunks(chunk)
        S, g, cost = parts[0]
        for more_S, more_g, more_cost in parts[1:]:
            S, g, cost = S + more_S, g + more_g, cost + more_cost
        n = len(self.R)
        S[:n] = np.triu(S[:n]) + np.triu(S[:n], 1).transpose(0, 2, 1)
        return S, g, cost

    def evaluate(self) -> tuple[Array, Array]:
        residual, weight = np.empty((len(self.obs.frame), 3)), np.empty((len(self.obs.frame), 2))
        evaluate_tracks(self.obs, self.model, self.R, self.t, self.X, residual, weight)
        return residual, weight

    def _chunks(self, work: Callable[[int, int], Part]) -> list[Part]:
        bounds = list(zip(self.cuts[:-1], self.cuts[1:], strict=True))
        if self.jobs == 1:
            return [work(low, high) for low, high in bounds]
        with ThreadPoolExecutor(self.jobs) as pool:
            return list(pool.map(lambda b: work(*b), bounds))


def _seen_together(obs: Observations, n: int) -> Ints:
    """(m, 2) pairs of frames that share a track."""
    together = np.zeros((n, n), bool)
    mark_seen_together(obs, together)
    return np.argwhere(together)


def _checked(
    T_world_cam: Array, frame: ArrayLike, track: ArrayLike, px: Array, z_m: Array
) -> tuple[Array, Ints, Ints, Array, Array]:
    T = np.asarray(T_world_cam, float)
    frame, track = np.asarray(frame, np.int64).reshape(-1), np.asarray(track, np.int64).reshape(-1)
    px, z = np.asarray(px, float).reshape(-1, 2), np.asarray(z_m, float).reshape(-1)
    if T.ndim != 3 or T.shape[1:] != (4, 4) or not len(T):
        raise ValueError(f"poses must be (n, 4, 4) with n > 0, not {T.shape}")
    if not len(frame) == len(track) == len(px) == len(z):
        raise ValueError(f"{len(frame)} frames, {len(track)} tracks, {len(px)} pixels, {len(z)} depths: not one a row")
    if len(frame) and (frame.min() < 0 or frame.max() >= len(T) or track.min() < 0):
        raise ValueError(f"observations name frames outside 0..{len(T) - 1} or negative tracks")
    if not (np.isfinite(T).all() and np.isfinite(px).all()):
        raise ValueError("poses and pixels must be finite")
    if np.any(z <= 0) or np.any(np.isinf(z)):
        raise ValueError("depths must be positive and finite, or NaN where there is none")
    return T, frame, track, px, z


def _kernel_inputs(
    frame: Ints, track: Ints, n_tracks: int, px: Array, z: Array, camera: Camera, settings: BundleSettings
) -> tuple[Observations, Model]:
    deep = np.isfinite(z)
    depth = np.where(deep, z, 0.0)
    inverse_sigma = np.where(deep, 1 / (settings.depth_sigma_factor * camera.noise.sigma_m(depth)), 0.0)
    start = np.searchsorted(track, np.arange(n_tracks + 1))
    obs = Observations(start, frame.astype(np.uint32), np.ascontiguousarray(px), depth, inverse_sigma)
    model = Model(
        float(camera.fx),
        float(camera.fy),
        float(camera.cx),
        float(camera.cy),
        1 / settings.sigma_px,
        float(settings.scale_px**2),
        float(settings.scale_depth**2),
        KERNELS[settings.kernel],
    )
    return obs, model
