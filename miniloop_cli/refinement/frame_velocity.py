"""The motion of the camera within a frame: from the path through all poses, and from the rows of the frame.

A path through poses some tenths of a second apart misses the motion of a hand in between. A rolling shutter records it:
each row has its own pose, so the points of a frame determine its velocity as well as its pose.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.refinement.bundle import BundleResult, BundleSettings
from miniloop_cli.refinement.jackknife import PARTS, image_part, remaining_fraction
from miniloop_cli.refinement.timing import Measurements
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Bools, Floats, Ints

MAX_GAP_S = 0.6  # frames farther apart do not determine the motion at a frame
# Rotation (rad/s), translation (m/s). How far a hand-held camera's velocity is from the derivative of its path, as
# measured on real recordings; and how fast it is if there is no path.
PATH_SIGMAS, SPEED_SIGMAS = (0.1, 0.05), (0.5, 0.3)
LEAST_OBSERVATIONS = 20


def path_runs(timestamps_s: Floats, known: Bools) -> list[Ints]:
    """The frames that are `known` (n,), cut where they are more than MAX_GAP_S apart; runs of three and more.

    timestamps_s (n,).
    """
    frames = np.flatnonzero(known)
    step_s = np.diff(timestamps_s[frames])
    runs = np.split(frames, np.flatnonzero((step_s > MAX_GAP_S) | (step_s <= 0)) + 1)
    return [run for run in runs if len(run) >= 3]


def twists(T_world_cam: Floats, timestamps_s: Floats, known: Bools) -> tuple[Floats, Floats]:
    """Velocity v (n, 3) m/s and angular velocity w (n, 3) rad/s of the camera in its own frame.

    Cubic splines through the poses T_world_cam (n, 4, 4) that are `known` (n,), cut where frames are more than
    MAX_GAP_S apart; zero for frames without neighbours.
    """
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    v, w = np.zeros((len(T_world_cam), 3)), np.zeros((len(T_world_cam), 3))
    for run in path_runs(timestamps_s, known):
        R, t = T_world_cam[run, :3, :3], T_world_cam[run, :3, 3]
        v[run] = np.einsum("nji,nj->ni", R, CubicSpline(timestamps_s[run], t)(timestamps_s[run], 1))
        w[run] = RotationSpline(timestamps_s[run], Rotation.from_matrix(R))(timestamps_s[run], 1)
    return v, w


def estimate_velocities(
    path: tuple[Floats, Floats],
    before: tuple[Floats, Floats],
    measured: Measurements,
    adjusted: BundleResult,
    timing: Timing,
    camera: Camera,
    settings: BundleSettings,
) -> tuple[tuple[Floats, Floats], Floats]:
    """Velocities v (n, 3) m/s and w (n, 3) rad/s under which each frame's measurements agree best with the points.

    Also the additional covariances (n, 6, 6) of each frame's pose (w, v) that come from its uncertain velocity; zero
    where no velocity was estimated.

    One Gauss-Newton step a frame over its pose and its twist, from a bundle adjustment in which the measurements were
    corrected with the twists `before`. A point at row share s is seen s readout_s later, so a pixel's derivative by the
    twist is that by the pose, times this time; depth follows `timing.corrected`. The twist has a Gaussian prior about
    that of the `path`, or about zero if frames are too far apart for a path. The mean deviation over all frames is
    attributed to calibration and removed.
    """
    T_cam_world = se3.inverse(adjusted.T_world_cam)
    known = adjusted.used & np.isfinite(adjusted.residual_px[:, 0])
    order = np.flatnonzero(known)[np.argsort(measured.frame[known], kind="stable")]
    start = np.searchsorted(measured.frame[order], np.arange(len(T_cam_world) + 1))
    centre, twist = np.concatenate(path[::-1], axis=1), np.concatenate(before[::-1], axis=1)
    felt, unsure = twist.copy(), np.zeros((len(twist), 6, 6))
    on_path = np.any(centre != 0, axis=1)
    near, free = (np.repeat(sigmas, 3) ** -2.0 for sigmas in (PATH_SIGMAS, SPEED_SIGMAS))
    for f in np.flatnonzero(np.diff(start) >= LEAST_OBSERVATIONS):
        prior = near if on_path[f] else free
        rows = order[start[f] : start[f + 1]]
        part = image_part(measured.px_ideal[rows], camera)
        H, g = _frame_systems(rows, part, T_cam_world[f], measured, adjusted, timing, camera, settings)
        H[:, range(6, 12), range(6, 12)] += prior
        g[:, 6:] += prior * (twist[f] - centre[f])
        twist_step = np.linalg.solve(_regular(H), g[..., None])[:, 6:, 0]
        felt[f] -= twist_step[0]
        unsure[f] = _by_twist(_regular(H[0]), prior, twist_step[1:] - twist_step[0], remaining_fraction(part))
    moved = (felt != twist).any(axis=1)
    if moved.any():
        felt[moved] -= np.median((felt - centre)[moved], axis=0)
    return (felt[:, 3:], felt[:, :3]), unsure


def _regular(H: Floats) -> Floats:
    return H + 1e-12 * np.trace(H, axis1=-2, axis2=-1)[..., None, None] * np.eye(12)


def _by_twist(H: Floats, prior: Floats, changes: Floats, left: Floats) -> Floats:
    """Covariance (6, 6) of a pose due to that of its twist; H (12, 12) with the prior (6,) of the twist.

    The covariance of the twist comes from the prior and from its changes (parts, 6) without each part of the image.
    """
    C = np.linalg.inv(H)[6:, 6:]
    of_twist = C @ (prior[:, None] * C) + changes.T @ (left[:, None] * changes)
    by_twist = np.linalg.solve(H[:6, :6], H[:6, 6:])
    return by_twist @ of_twist @ by_twist.T


def _frame_systems(
    rows: Ints,
    part: Ints,
    T_cam_world: Floats,
    measured: Measurements,
    adjusted: BundleResult,
    timing: Timing,
    camera: Camera,
    settings: BundleSettings,
) -> tuple[Floats, Floats]:
    """Normal equations H (1 + PARTS, 12, 12), g (1 + PARTS, 12) of one frame's measurements by its pose and its twist,
    both as (w, v): of all, and without each part of the image.
    """
    X = se3.transform(T_cam_world, adjusted.points_world[measured.track[rows]])
    z = X[:, 2:]
    # A camera that turns by w and moves by v moves its points by X x w - v.
    by_pose = np.concatenate([se3.hat(X), np.broadcast_to(-np.eye(3), (len(X), 3, 3))], axis=2)
    px_by_pose = np.stack(
        [f * (by_pose[:, k] - X[:, k, None] / z * by_pose[:, 2]) / z for k, f in enumerate((camera.fx, camera.fy))],
        axis=1,
    )
    row_s = timing.readout_s * measured.row_share[rows]
    late_s = measured.stamp_lag_s[rows] + timing.lag_s
    px_by_both = np.concatenate([px_by_pose, row_s[:, None, None] * px_by_pose], axis=2) / settings.sigma_px
    along = np.einsum("ki,kij->kj", measured.slope[rows], px_by_pose)
    depth_by_twist = (late_s + row_s)[:, None] * by_pose[:, 2] - late_s[:, None] * along
    sigma_z_m = settings.depth_sigma_factor * camera.noise.sigma_m(np.nan_to_num(measured.z_m[rows], nan=1.0))
    depth_by_both = np.concatenate([by_pose[:, 2], depth_by_twist], axis=1) / sigma_z_m[:, None]
    J = np.concatenate([px_by_both, depth_by_both[:, None]], axis=1)
    r = np.concatenate([adjusted.residual_px[rows], np.nan_to_num(adjusted.residual_depth[rows])[:, None]], axis=1)
    weight = np.stack([adjusted.weight_px[rows]] * 2 + [adjusted.weight_depth[rows]], axis=1)
    J_weighted = weight[:, :, None] * J
    inside = [np.flatnonzero(part == number) for number in range(PARTS)]
    H = np.array([np.einsum("kri,krj->ij", J_weighted[k], J[k]) for k in inside])
    g = np.array([np.einsum("kri,kr->i", J_weighted[k], r[k]) for k in inside])
    return _whole_and_without(H), _whole_and_without(g)


def _whole_and_without(of_parts: Floats) -> Floats:
    """(1 + parts, ...) the sum over the parts (parts, ...), and without each."""
    whole = of_parts.sum(axis=0)
    return np.concatenate([whole[None], whole - of_parts])
