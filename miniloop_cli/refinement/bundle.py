"""Bundle adjustment of RGB-D tracks: all poses and points at once, with the intrinsics fixed.

Every observation gives a pixel residual (2, in units of `sigma_px`, the same for all image scales) and, where depth
was measured, a depth residual (z_predicted - z_measured) / (depth_sigma_factor sigma_z(z_measured)), each under its own
robust kernel. Levenberg-Marquardt with the points eliminated by the Schur complement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.se3 import pose, project_so3, transform
from miniloop_cli.refinement.bundle_problem import Bundle
from miniloop_cli.refinement.gauge import anchor_of, restoring_motion, with_untied
from miniloop_cli.refinement.jackknife import image_part
from miniloop_cli.refinement.levenberg_marquardt import Descent, minimise
from miniloop_cli.refinement.points import initial_points
from miniloop_cli.refinement.robust import KERNELS, Kernel
from miniloop_cli.refinement.track_terms import Model, Observations
from miniloop_cli.typing import Bools, Floats, Ints


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
    fixed_frame: int | None = None  # keeps its pose; by default the frame with the most observations
    covariance: bool = True


@dataclass(frozen=True)
class BundleResult:
    """Poses (n, 4, 4), points (p, 3), and of the k observations what is left.

    covariance (n, 6, 6), None if not asked for: of (w, v) in T_world_cam(true) = T_world_cam [exp(w) | v], given the
    fixed frame, which has zero; infinite for frames that no chain of tracks ties to it. `used` (k,): the observation
    took part. residual_px (k, 2) and residual_depth (k,) in sigmas, NaN where there is none; weights (k,) in [0, 1].
    """

    T_world_cam: Floats
    points_world: Floats
    covariance: Floats | None
    used: Bools
    residual_px: Floats
    residual_depth: Floats
    weight_px: Floats
    weight_depth: Floats
    fixed_frame: int
    descent: Descent


def bundle_adjust(
    T_world_cam: Floats,
    frame: ArrayLike,
    track: ArrayLike,
    px_ideal: Floats,
    z_m: Floats,
    camera: Camera,
    settings: BundleSettings | None = None,
    jobs: int = 1,
    points_world: Floats | None = None,
) -> BundleResult:
    """Refine poses (n, 4, 4) and the points of tracks.

    frame, track (k,) ints; px_ideal (k, 2) undistorted pixels; z_m (k,) depth in metres, NaN where none was measured.
    `jobs` threads change the time, not one bit of the result. `points_world` (tracks, 3): where points begin, as an
    earlier adjustment left them; NaN, or no such row, where that is to be found from the measurements.
    The fixed frame keeps its pose, as do frames without observations and the first frame of a group that nothing ties
    to the fixed one. A track seen once, or whose rays leave its depth open, does not take part; its point is NaN.
    Raises ValueError for shapes that do not fit, numbers that are not finite, or a frame twice in a track.
    """
    settings = settings or BundleSettings()
    T, frame, track, px, z = _checked(T_world_cam, frame, track, px_ideal, z_m)
    # Sums of large coordinates would cost digits: work relative to the mean camera.
    origin = T[:, :3, 3].mean(axis=0)
    R, t = np.ascontiguousarray(project_so3(T[:, :3, :3])), T[:, :3, 3] - origin

    order = np.lexsort((frame, track))
    if np.any((np.diff(frame[order]) == 0) & (np.diff(track[order]) == 0)):
        raise ValueError("a track sees the same frame twice")
    n_tracks = int(track.max(initial=-1)) + 1
    X, good = initial_points(R, t, frame[order], track[order], n_tracks, px[order], z[order], camera)
    if points_world is not None:
        known = np.flatnonzero(np.isfinite(points_world[:n_tracks]).all(axis=1))
        X[known], good[known] = points_world[known] - origin, True
    order = order[good[track[order]]]
    obs, model = _kernel_inputs(frame[order], track[order], n_tracks, px[order], z[order], camera, settings)
    fixed_frame = settings.fixed_frame
    if fixed_frame is None:
        fixed_frame = int(np.argmax(np.bincount(obs.frame, minlength=len(T))))
    if not 0 <= fixed_frame < len(T):
        raise ValueError(f"no frame {fixed_frame} to hold fixed among {len(T)}")

    problem = Bundle(obs, model, R, t, X, jobs)
    descent = minimise(problem, settings.max_iterations, settings.relative_tolerance)
    residual, weight = problem.evaluate()
    anchor = anchor_of(len(T), problem.pairs, fixed_frame)
    covariance = None
    if settings.covariance:
        covariance = problem.covariance(anchor, image_part(obs.px, camera))
        covariance = with_untied(covariance, anchor, fixed_frame)

    refined = pose(problem.R, problem.t + origin)
    motion = restoring_motion(T, refined, anchor)
    points = np.full((n_tracks, 3), np.nan)
    seen_by = obs.frame[obs.start[:-1][good]]
    points[good] = transform(motion[seen_by], (problem.X + origin)[good][:, None])[:, 0]
    used = np.zeros(len(frame), bool)
    used[order] = True
    all_residuals, all_weights = np.full((len(frame), 3), np.nan), np.zeros((len(frame), 2))
    all_residuals[order], all_weights[order] = residual, weight
    all_residuals[np.isnan(z), 2], all_weights[np.isnan(z), 1] = np.nan, 0.0
    return BundleResult(
        motion @ refined,
        points,
        covariance,
        used,
        all_residuals[:, :2],
        all_residuals[:, 2],
        all_weights[:, 0],
        all_weights[:, 1],
        fixed_frame,
        descent,
    )


def _checked(
    T_world_cam: Floats, frame: ArrayLike, track: ArrayLike, px: Floats, z_m: Floats
) -> tuple[Floats, Ints, Ints, Floats, Floats]:
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
    frame: Ints, track: Ints, n_tracks: int, px: Floats, z: Floats, camera: Camera, settings: BundleSettings
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
