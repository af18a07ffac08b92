"""Bundle adjustment of RGB-D tracks: all poses and points at once, with the intrinsics fixed.

Every observation gives a pixel residual (2, in units of `sigma_px`, the same for all image scales) and, where depth
was measured, a depth residual (z_predicted - z_measured) / (depth_sigma_factor sigma_z(z_measured)), each under its own
robust kernel; further terms may be given. Levenberg-Marquardt with the points eliminated by the Schur complement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.se3 import project_so3, transform
from miniloop_cli.refinement.bundle_problem import Bundle
from miniloop_cli.refinement.depth_term import DepthTerm
from miniloop_cli.refinement.gauge import anchor_of, restoring_motion, with_untied
from miniloop_cli.refinement.jackknife import image_part
from miniloop_cli.refinement.levenberg_marquardt import Descent, minimise
from miniloop_cli.refinement.pixel_term import PixelTerm
from miniloop_cli.refinement.point_equations import LEAST_CURVATURE
from miniloop_cli.refinement.points import initial_points
from miniloop_cli.refinement.robust import Kernel, Robust
from miniloop_cli.refinement.terms import NEAR_M, PointTerm, PoseTerm
from miniloop_cli.refinement.track_rows import TrackRows
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
    least_curvature: float = LEAST_CURVATURE  # of kernels, as a share of their weights; 1: reweighted least squares


@dataclass(frozen=True)
class BundleResult:
    """Poses (n, 4, 4), points (p, 3), and the residuals of the k observations.

    covariance (n, 6, 6), None unless requested: of (w, v) in T_world_cam(true) = T_world_cam [exp(w) | v], given the
    fixed frame, which has zero; infinite for frames that no chain of tracks joins to it. `used` (k,): whether the
    observation took part. residual_px (k, 2) and residual_depth (k,) in sigmas, NaN where there is none; weights (k,)
    in [0, 1].
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
    pose_terms: Sequence[PoseTerm] = (),
    point_terms: Sequence[PointTerm] = (),
    held: Bools | None = None,
) -> BundleResult:
    """Refine poses (n, 4, 4) and the points of tracks.

    frame, track (k,) ints; px_ideal (k, 2) undistorted pixels; z_m (k,) depth in metres, NaN where none was measured.
    The result does not depend on the number of `jobs` (threads). `points_world` (tracks, 3): initial points, as from an
    earlier adjustment; points that are NaN or missing there are initialised from the measurements.
    `pose_terms` and `point_terms` (their rows are the k observations) are minimised along with pixels and depths.
    `held` (n,): these frames, the fixed one among them, keep their poses; covariances are relative to them.
    The fixed frame keeps its pose, as do frames without observations. So does the first frame of a group that is not
    joined to the fixed one, except in what pose terms measure of it. A track does not take part if it is seen once, or
    if its rays do not determine its depth; its point is NaN.
    Raises ValueError for shapes that do not fit, numbers that are not finite, or a frame twice in a track.
    """
    settings = settings or BundleSettings()
    T, frame, track, px, z = _checked(T_world_cam, frame, track, px_ideal, z_m)
    # Large coordinates lose digits in sums, so positions are relative to the mean camera.
    origin = T[:, :3, 3].mean(axis=0)
    R, t = np.ascontiguousarray(project_so3(T[:, :3, :3])), T[:, :3, 3] - origin

    order = np.lexsort((frame, track))
    if np.any((np.diff(frame[order]) == 0) & (np.diff(track[order]) == 0)):
        raise ValueError("a track sees the same frame twice")
    n_tracks = int(track.max(initial=-1)) + 1
    given = np.full((n_tracks, 3), np.nan)
    if points_world is not None:
        given[: len(points_world)] = points_world[:n_tracks] - origin
    known = np.isfinite(given).all(axis=1)
    rest = order[~known[track[order]]]
    X, good = initial_points(R, t, frame[rest], track[rest], n_tracks, px[rest], z[rest], camera)
    X[known], good = given[known], good | known
    order = order[good[track[order]]]
    tracks = TrackRows(np.searchsorted(track[order], np.arange(n_tracks + 1)), frame[order].astype(np.uint32))
    terms: list[PointTerm] = [*_measured_terms(px, z, camera, settings), *point_terms]
    terms = [term.of(order) for term in terms]
    held = np.zeros(len(T), bool) if held is None else np.asarray(held, bool)
    fixed_frame = settings.fixed_frame
    if fixed_frame is None:
        seen = np.bincount(tracks.frame, minlength=len(T))
        fixed_frame = int(np.argmax(np.where(held, seen, 0) if held.any() else seen))
    if not 0 <= fixed_frame < len(T):
        raise ValueError(f"no frame {fixed_frame} to hold fixed among {len(T)}")

    problem = Bundle(tracks, terms, pose_terms, R, t, X, origin, jobs, settings.least_curvature, held)
    descent = minimise(problem, settings.max_iterations, settings.relative_tolerance)
    anchor = anchor_of(len(T), problem.pairs, fixed_frame, held)
    covariance = None
    if settings.covariance:
        covariance = problem.covariance(anchor, image_part(px[order], camera))
        covariance = with_untied(covariance, anchor, fixed_frame, held)

    refined = problem.T_world_cam
    motion = restoring_motion(T, refined, anchor, pose_terms)
    points = np.full((n_tracks, 3), np.nan)
    seen_by = tracks.frame[tracks.start[:-1][good]]
    points[good] = transform(motion[seen_by], (problem.state.X + origin)[good][:, None])[:, 0]
    used = np.zeros(len(frame), bool)
    used[order] = True
    (residual_px, weight_px), (residual_z, weight_z) = (
        _placed(term, problem.state.seen.p_cam, order, len(frame)) for term in terms[:2]
    )
    return BundleResult(
        motion @ refined,
        points,
        covariance,
        used,
        residual_px,
        residual_z[:, 0],
        weight_px,
        weight_z,
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


def _measured_terms(px: Floats, z: Floats, camera: Camera, settings: BundleSettings) -> tuple[PixelTerm, DepthTerm]:
    """The terms of pixels (k, 2) and of depths (k,)."""
    sigma_m = settings.depth_sigma_factor * camera.noise.sigma_m(np.where(np.isfinite(z), z, 1.0))
    return (
        PixelTerm(np.ascontiguousarray(px.T), camera, settings.sigma_px, Robust(settings.kernel, settings.scale_px)),
        DepthTerm(z, sigma_m, Robust(settings.kernel, settings.scale_depth)),
    )


def _placed(term: PointTerm, p_cam: Floats, order: Ints, count: int) -> tuple[Floats, Floats]:
    """Residuals (count, d) and weights (count,) of a term whose rows are `order`; NaN and 0 where there is none."""
    found = term.linearise(p_cam)[0].T
    found[p_cam[2] < NEAR_M] = np.nan
    residual, weight = np.full((count, found.shape[1]), np.nan), np.zeros(count)
    residual[order], weight[order] = found, np.nan_to_num(term.robust.weight((found**2).sum(axis=1)))
    return residual, weight
