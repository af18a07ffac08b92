"""Random minimal problems with known truth: exact cycles of scans that see random points of one cube."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.geometry import se3
from miniloop_cli.solvers.batch import edges_of

Array = NDArray[np.float64]


def random_rotations(rng: np.random.Generator, shape: tuple[int, ...], upright: bool = False) -> Array:
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
) -> tuple[Array, Array, Array]:
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
