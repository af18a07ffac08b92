"""First positions of track points from given poses."""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry.camera import Camera
from miniloop_cli.typing import Bools, Floats, Ints

_MIN_PARALLAX_RAD = np.radians(1.0)
_WEISZFELD_STEPS = 6


def initial_points(
    R_world_cam: Floats,
    t_world_cam: Floats,
    frame: Ints,
    track: Ints,
    n_tracks: int,
    px: Floats,
    z_m: Floats,
    camera: Camera,
) -> tuple[Floats, Bools]:
    """(p, 3) world points of the tracks and whether each can be trusted (p,); the others are zero.

    Poses R_world_cam (n, 3, 3), t_world_cam (n, 3) m. Observations `frame`, `track` (k,), px (k, 2) undistorted pixels
    and z_m (k,) are sorted by track; z_m is NaN where there is no depth. With depth: the weighted geometric median of
    the back-projected points (Weiszfeld's iteration), which is robust to one wrong depth. Without: the point nearest to
    all rays, if their angle is a degree or more. A track seen in one frame is not trusted.
    """
    X, good = np.zeros((n_tracks, 3)), np.zeros(n_tracks, bool)
    ray = camera.backproject(px, np.ones(len(px)))
    enough = np.bincount(track, minlength=n_tracks) >= 2
    deep = np.isfinite(z_m)
    with_depth = enough & (np.bincount(track[deep], minlength=n_tracks) > 0)

    take = deep & with_depth[track]
    if take.any():
        f = frame[take]
        points = np.einsum("kij,kj->ki", R_world_cam[f], ray[take] * z_m[take, None]) + t_world_cam[f]
        names, start = np.unique(track[take], return_index=True)
        X[names] = _geometric_medians(points, 1 / camera.noise.sigma_m(z_m[take]), start)
        good[names] = True

    take = (enough & ~with_depth)[track]
    if take.any():
        f = frame[take]
        d = np.einsum("kij,kj->ki", R_world_cam[f], ray[take])
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        names, start = np.unique(track[take], return_index=True)
        X[names], good[names] = _nearest_to_rays(t_world_cam[f], d, start)
    return X, good


def _geometric_medians(points: Floats, weight: Floats, start: Ints) -> Floats:
    """Weighted geometric medians of the groups of rows (k, 3) that begin at `start`."""
    group = np.repeat(np.arange(len(start)), np.diff([*start, len(points)]))
    w = weight * weight
    for _ in range(_WEISZFELD_STEPS):
        centre = np.add.reduceat(points * w[:, None], start) / np.add.reduceat(w, start)[:, None]
        # Without this floor, a tenth of a sigma, the iteration would stop at a point that coincides with the centre.
        w = weight / np.maximum(np.linalg.norm(points - centre[group], axis=1), 0.1 / weight)
    return centre


def _nearest_to_rays(origin: Floats, direction: Floats, start: Ints) -> tuple[Floats, Bools]:
    """Least-squares intersections of groups of rays (k, 3), (k, 3) unit, and whether their angle is large enough."""
    P = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    A, b = np.add.reduceat(P, start), np.add.reduceat(np.einsum("kij,kj->ki", P, origin), start)
    # The smallest eigenvalue of A is the sum of the squared sines of the rays against their mean direction.
    count = np.diff([*start, len(origin)])
    good = np.linalg.eigvalsh(A)[:, 0] > count * np.sin(_MIN_PARALLAX_RAD / 2) ** 2
    X = np.zeros_like(b)
    X[good] = np.linalg.solve(A[good], b[good][..., None])[..., 0]
    group = np.repeat(np.arange(len(start)), count)
    ahead = np.minimum.reduceat(np.einsum("ki,ki->k", X[group] - origin, direction), start) > 0
    return np.where((good & ahead)[:, None], X, 0.0), good & ahead
