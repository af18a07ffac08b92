"""Many minimal samples at once, or one at a time for people: arrays in, arrays out, around the compiled solvers.

Every solver module has MATCHES (matches an edge, the closing edge last), MAX_SOLUTIONS, the compiled core
`solve(p, q, T) -> count`, `solve_batch(p, q) -> (T, counts)` and an entry named after itself for one sample.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from miniloop_cli.errors import MiniloopError
from miniloop_cli.geometry import se3
from miniloop_cli.typing import Floats, Ints


def edges_of(matches: tuple[int, ...]) -> list[tuple[int, int]]:
    """The scans that each edge joins, counted from 0: a chain and, beyond two scans, its closing edge."""
    scans = max(len(matches), 2)
    chain = [(e, e + 1) for e in range(scans - 1)]
    return chain if len(matches) == 1 else [*chain, (0, scans - 1)]


def run_batch(
    solve_all: Callable, matches: tuple[int, ...], solutions: int, p: Floats, q: Floats, *options: float
) -> tuple[Floats, Ints]:
    """Solutions T (b, solutions, n-1, 3, 4) and their counts (b,) of b samples p, q (b, k, 3); unused slots are zero.

    `solve_all(p, q, T, counts, *options)` is the compiled loop of a solver. Raises MiniloopError if a shape is wrong.
    """
    p, q = np.ascontiguousarray(p, float), np.ascontiguousarray(q, float)
    if p.ndim != 3 or p.shape[1:] != (sum(matches), 3) or p.shape != q.shape:
        raise MiniloopError(f"this solver takes samples p, q (b, {sum(matches)}, 3), got {p.shape} and {q.shape}")
    T = np.zeros((len(p), solutions, max(len(matches), 2) - 1, 3, 4))
    counts = np.zeros(len(p), np.int64)
    solve_all(p, q, T, counts, *options)
    return T, counts


def run_single(solve_batch: Callable, matches: tuple[int, ...], p: Floats, q: Floats, best: bool) -> Floats:
    """Solutions (s, n-1, 4, 4) of one sample p, q (k, 3); with `best` only the one of least residual, if any."""
    T, counts = solve_batch(np.asarray(p, float)[None], np.asarray(q, float)[None])
    poses = se3.pose(T[0, : counts[0], ..., :3], T[0, : counts[0], ..., 3])
    if best and len(poses) > 1:
        residuals = np.linalg.norm(match_residuals(poses, p, q, matches), axis=-1)
        poses = poses[[residuals.argmin()]]
    return poses


def match_residuals(poses: Floats, p: Floats, q: Floats, matches: tuple[int, ...]) -> Floats:
    """Distances (..., k) of p, moved along the chain, from q: poses (..., n-1, 4, 4), p and q (..., k, 3) or (k, 3)."""
    chain = [poses[..., e, :, :] for e in range(poses.shape[-3])]
    if len(matches) > 1:
        closing = chain[0]
        for pose in chain[1:]:
            closing = pose @ closing
        chain.append(closing)
    T = np.repeat(np.stack(chain, axis=-3), matches, axis=-3)
    moved = np.einsum("...kij,...kj->...ki", T[..., :3, :3], p) + T[..., :3, 3]
    return np.linalg.norm(moved - q, axis=-1)
