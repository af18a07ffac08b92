"""Guided matching: with the relative pose known, a feature is looked for only where it must appear.

The window is small, so few candidates compete: matches that the ratio test over the whole image had to refuse are
found, features without a depth of their own can be matched, and the cost a pair is a fraction of a matrix product.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from miniloop_cli.config import Settings
from miniloop_cli.features.detect import compact
from miniloop_cli.features.lift import ScanFeatures
from miniloop_cli.parallel import Workers
from miniloop_cli.scans.camera import Camera

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
CELL_PX = 16.0


def guided_matches(
    pairs: Sequence[tuple[int, int]],
    T_j_i: Floats,
    features: Sequence[ScanFeatures],
    camera: Camera,
    radius_px: float,
    settings: Settings,
    workers: Workers,
) -> list[Ints]:
    """Matches of each pair (i, j) where its relative pose T_j_i (m, 4, 4) says they must be, as `guided_match`."""
    named = {k for pair in pairs for k in pair}
    small = {k: compact(features[k].descriptors, settings.features.type) for k in named}

    def one(item: tuple[tuple[int, int], Floats]) -> Ints:
        (i, j), T = item
        max_distance2 = settings.bundle.max_distance2 * small[i][1]
        return guided_match(features[i], features[j], small[i][0], small[j][0], T, camera, radius_px, max_distance2)

    return list(workers.map(one, list(zip(pairs, T_j_i, strict=True)), "matching, guided", len(pairs)))


def guided_match(
    a: ScanFeatures,
    b: ScanFeatures,
    descriptors_a: NDArray[np.uint8],
    descriptors_b: NDArray[np.uint8],
    T_b_a: Floats,
    camera: Camera,
    radius_px: float,
    max_distance2: float,
) -> Ints:
    """Matches (m, 2) of the features of scans a and b whose relative pose T_b_a (4, 4) is known.

    Each feature of a with depth is projected into b and compared with the features within `radius_px`; where both
    have a depth, the depths must agree within 3 sigma and 5 %. The best candidate must be nearer than
    `max_distance2` (squared distance of the compact descriptors). The same from b to a; a pair is kept if one
    direction found it and nothing contradicts it.
    """
    T_a_b = np.linalg.inv(T_b_a)
    forward = _direction(a, b, descriptors_a, descriptors_b, T_b_a, camera, radius_px, max_distance2)
    backward = _direction(b, a, descriptors_b, descriptors_a, T_a_b, camera, radius_px, max_distance2)
    return agreed(forward, backward)


def _direction(
    a: ScanFeatures,
    b: ScanFeatures,
    descriptors_a: NDArray[np.uint8],
    descriptors_b: NDArray[np.uint8],
    T_b_a: Floats,
    camera: Camera,
    radius_px: float,
    max_distance2: float,
) -> Ints:
    count = a.with_depth
    p_b = camera.backproject(a.px_ideal[:count], a.z_m[:count]) @ T_b_a[:3, :3].T + T_b_a[:3, 3]
    ahead = p_b[:, 2] > 0.05
    px = np.full((count, 2), -1e6)
    px[ahead] = camera.project(p_b[ahead])
    tolerance_m = 3 * 2 * camera.noise.sigma_m(p_b[:, 2]) + 0.05 * p_b[:, 2]
    order, start, columns = _grid(b.px_ideal, camera)
    return search_windows(
        px, p_b[:, 2], tolerance_m, descriptors_a, b.px_ideal, b.z_m, descriptors_b, order, start, columns,
        radius_px, max_distance2,
    )  # fmt: skip


def _grid(px: Floats, camera: Camera) -> tuple[Ints, Ints, int]:
    """Features sorted by cell: order (n,), start (cells + 1,), columns. Features outside lie in the border cells."""
    columns, rows = int(camera.width // CELL_PX) + 1, int(camera.height // CELL_PX) + 1
    x = np.clip(px[:, 0] // CELL_PX, 0, columns - 1).astype(np.int64)
    y = np.clip(px[:, 1] // CELL_PX, 0, rows - 1).astype(np.int64)
    cell = y * columns + x
    return np.argsort(cell, kind="stable"), np.searchsorted(np.sort(cell), np.arange(rows * columns + 1)), columns


@njit(cache=True, nogil=True, fastmath=True)
def search_windows(
    px: Floats,
    z_m: Floats,
    tolerance_m: Floats,
    descriptors_a: NDArray[np.uint8],
    px_b: Floats,
    z_b: Floats,
    descriptors_b: NDArray[np.uint8],
    order: Ints,
    start: Ints,
    columns: int,
    radius_px: float,
    max_distance2: float,
) -> Ints:
    """Best feature of b (n,) for each predicted pixel (n, 2) and depth (n,) of a's features; -1 where there is none."""
    rows = (start.shape[0] - 1) // columns
    found = np.full(px.shape[0], -1)
    for k in range(px.shape[0]):
        u, v = px[k, 0], px[k, 1]
        left, right = int(np.floor((u - radius_px) / CELL_PX)), int(np.floor((u + radius_px) / CELL_PX))
        top, bottom = int(np.floor((v - radius_px) / CELL_PX)), int(np.floor((v + radius_px) / CELL_PX))
        if right < 0 or bottom < 0 or left >= columns or top >= rows:
            continue
        best, which = max_distance2, -1
        for row in range(max(top, 0), min(bottom, rows - 1) + 1):
            first = start[row * columns + max(left, 0)]
            last = start[row * columns + min(right, columns - 1) + 1]
            for at in range(first, last):
                b = order[at]
                if (px_b[b, 0] - u) ** 2 + (px_b[b, 1] - v) ** 2 > radius_px * radius_px:
                    continue
                if abs(z_b[b] - z_m[k]) > tolerance_m[k]:
                    continue
                distance = np.int32(0)
                for d in range(descriptors_a.shape[1]):
                    difference = np.int32(descriptors_a[k, d]) - np.int32(descriptors_b[b, d])
                    distance += difference * difference
                if distance < best:
                    best, which = distance, b
        found[k] = which
    return found


def agreed(forward: Ints, backward: Ints) -> Ints:
    """Pairs (m, 2) of the two directions' answers (n_a,), (n_b,) that no other answer contradicts, sorted."""
    ab = np.stack([np.flatnonzero(forward >= 0), forward[forward >= 0]], axis=1)
    ba = np.stack([backward[backward >= 0], np.flatnonzero(backward >= 0)], axis=1)
    pairs = np.unique(np.concatenate([ab, ba]), axis=0)
    once_a = np.bincount(pairs[:, 0], minlength=1)[pairs[:, 0]] == 1 if len(pairs) else np.zeros(0, bool)
    once_b = np.bincount(pairs[:, 1], minlength=1)[pairs[:, 1]] == 1 if len(pairs) else np.zeros(0, bool)
    return pairs[once_a & once_b]
