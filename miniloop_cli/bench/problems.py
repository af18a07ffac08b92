"""Random problems with known truth: exact minimal ones of scans in a cube, and noisy cycles with wrong matches."""

from __future__ import annotations

from functools import reduce

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.ransac.matches import EdgeMatches
from miniloop_cli.solvers.batch import edges_of
from miniloop_cli.typing import Floats


def random_rotations(rng: np.random.Generator, shape: tuple[int, ...], upright: bool = False) -> Floats:
    """Uniform rotations (*shape, 3, 3), of all or, with `upright`, about z."""
    if upright:
        angle = rng.uniform(-np.pi, np.pi, shape)
        return se3.exp_so3(np.stack([np.zeros(shape), np.zeros(shape), angle], axis=-1))
    a = rng.normal(size=(*shape, 4))
    w, x, y, z = np.moveaxis(a / np.linalg.norm(a, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def random_problems(
    rng: np.random.Generator, matches: tuple[int, ...], count: int, side: float = 1.0, upright: bool = False
) -> tuple[Floats, Floats, Floats]:
    """`count` minimal samples p, q (count, k, 3) and their true poses T (count, n-1, 4, 4), scan e -> scan e+1.

    Scans stand and points lie anywhere in a cube of the given side, as in the paper's synthetic data (sec. 5.1), where
    it is 400 units; the matches of different edges are different points.
    """
    edges = edges_of(matches)
    scans = max(len(matches), 2)
    centre = rng.uniform(-0.5 * side, 0.5 * side, (count, scans, 3))
    T_scan_world = se3.inverse(se3.pose(random_rotations(rng, (count, scans), upright), centre))
    p, q = [], []
    for (i, j), number in zip(edges, matches, strict=True):
        points = rng.uniform(-0.5 * side, 0.5 * side, (count, number, 3))
        p.append(se3.transform(T_scan_world[:, i], points))
        q.append(se3.transform(T_scan_world[:, j], points))
    T = T_scan_world[:, 1:] @ se3.inverse(T_scan_world[:, :-1])
    return np.concatenate(p, axis=1), np.concatenate(q, axis=1), T


def noisy_cycle(
    rng: np.random.Generator,
    scans: int,
    matches: int = 200,
    outliers: float = 0.4,
    sigma_m: float = 0.005,
    upright: bool = False,
) -> tuple[list[EdgeMatches], Floats]:
    """Edges of a pair or a cycle of scans, the closing edge last, and their true poses T (edges, 4, 4).

    Cameras turn and move by 0.3 rad and 0.3 m (standard deviation an axis) from scan to scan; points lie within 2 m of
    a place 2.5 m before the first scan of their edge, with the same noise an axis in both scans. Of the `matches` of
    an edge this share, at random places, are wrong: their second point is another point of such a place.
    """
    w = rng.normal(size=(scans - 1, 3), scale=0.3) * ([0, 0, 1] if upright else [1, 1, 1])
    T = list(se3.pose(se3.exp_so3(w), rng.normal(size=(scans - 1, 3), scale=0.3)))
    if scans > 2:
        T.append(reduce(lambda whole, step: step @ whole, T))
    edges, covariance = [], np.broadcast_to(sigma_m**2 * np.eye(3), (matches, 3, 3))
    low, high = [-2.0, -2.0, 0.5], [2.0, 2.0, 4.5]
    for pose in T:
        p = rng.uniform(low, high, (matches, 3))
        q = se3.transform(pose, p)
        wrong = rng.permutation(matches)[: round(outliers * matches)]
        q[wrong] = se3.transform(pose, rng.uniform(low, high, (len(wrong), 3)))
        p, q = (x + rng.normal(size=x.shape, scale=sigma_m) for x in (p, q))
        edges.append(EdgeMatches(p, q, covariance, covariance))
    return edges, np.array(T)
