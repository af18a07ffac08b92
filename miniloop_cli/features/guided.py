"""Guided matching: with a known relative pose, a feature is searched only near its predicted position.

A small window has few candidates. Therefore matches are found that fail the ratio test over the whole image, features
without depth can be matched, and a pair costs a fraction of a matrix product.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from miniloop_cli.config import Bundle
from miniloop_cli.features.detect import compact
from miniloop_cli.features.lsh_match import squared_distance
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.runtime.kernels import njit
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.features import ScanFeatures
from miniloop_cli.typing import Bytes, Floats, Ints

CELL_PX = 16.0
NEAR_M = 0.05  # a point nearer than this (or behind) has no useful projection


def guided_matches(
    pairs: Sequence[tuple[int, int]],
    T_j_i: Floats,
    features: Sequence[ScanFeatures],
    feature_type: str,
    camera: Camera,
    settings: Bundle,
    workers: Workers,
) -> list[Ints]:
    """Matches (k, 2) of each pair (i, j) with relative pose T_j_i (m, 4, 4), by `guided_match`."""
    named = {k for pair in pairs for k in pair}
    small = {k: compact(features[k].descriptors, feature_type) for k in named}
    ready = {k: searchable(features[k], small[k][0], camera) for k in named}

    def one(item: tuple[tuple[int, int], Floats]) -> Ints:
        (i, j), T = item
        max_distance2 = settings.max_distance2 * small[i][1]
        return guided_match(ready[i], ready[j], T, camera, settings.radius_px, max_distance2)

    return list(workers.map(one, list(zip(pairs, T_j_i, strict=True)), "matching, guided", len(pairs)))


@dataclass(frozen=True)
class Searchable:
    """Features of a scan with their compact descriptors (n, d), sorted by the cells of a grid over the image.

    p_cam (with_depth, 3) points of the features with depth; order (n,) features by cell; start (cells + 1,); features
    outside of the image lie in the border cells.
    """

    features: ScanFeatures
    descriptors: Bytes
    p_cam: Floats
    order: Ints
    start: Ints


def searchable(features: ScanFeatures, descriptors: Bytes, camera: Camera) -> Searchable:
    """Features with descriptors (n, d), ready for guided matching."""
    columns, rows = _columns(camera), int(camera.height // CELL_PX) + 1
    x = np.clip(features.px_ideal[:, 0] // CELL_PX, 0, columns - 1).astype(np.int64)
    y = np.clip(features.px_ideal[:, 1] // CELL_PX, 0, rows - 1).astype(np.int64)
    cell = y * columns + x
    order = np.argsort(cell, kind="stable")
    p_cam = camera.backproject(features.px_ideal[: features.with_depth], features.z_m[: features.with_depth])
    return Searchable(features, descriptors, p_cam, order, np.searchsorted(cell[order], np.arange(rows * columns + 1)))


def _columns(camera: Camera) -> int:
    return int(camera.width // CELL_PX) + 1


def guided_match(
    a: Searchable, b: Searchable, T_b_a: Floats, camera: Camera, radius_px: float, max_distance2: float
) -> Ints:
    """Matches (m, 2) of the features of scans a and b whose relative pose T_b_a (4, 4) is known.

    Each feature of a with depth is projected into b and compared with the features within `radius_px`; where both
    have a depth, the depths must agree within 3 sigma and 5 %. The best candidate must be nearer than
    `max_distance2` (squared distance of the compact descriptors). The same from b to a; a pair is kept if one
    direction found it and nothing contradicts it.
    """
    forward = _direction(a, b, T_b_a, camera, radius_px, max_distance2)
    backward = _direction(b, a, se3.inverse(T_b_a), camera, radius_px, max_distance2)
    return agreed(forward, backward)


def _direction(
    a: Searchable, b: Searchable, T_b_a: Floats, camera: Camera, radius_px: float, max_distance2: float
) -> Ints:
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    noise = (camera.noise.a_m, camera.noise.b_per_m, camera.noise.z0_m)
    return search_windows(
        a.p_cam, T_b_a, lens, noise, a.descriptors, b.features.px_ideal, b.features.z_m, b.descriptors, b.order,
        b.start, _columns(camera), radius_px, max_distance2,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def search_windows(
    p_a: Floats,
    T_b_a: Floats,
    lens: tuple[float, float, float, float],
    noise: tuple[float, float, float],
    descriptors_a: Bytes,
    px_b: Floats,
    z_b: Floats,
    descriptors_b: Bytes,
    order: Ints,
    start: Ints,
    columns: int,
    radius_px: float,
    max_distance2: float,
) -> Ints:
    """Best feature of b (n,) for each of a's points (n, 3), -1 where there is none.

    T_b_a (4, 4); descriptors_a and descriptors_b (.., d); px_b (m, 2) undistorted pixels and z_b (m,) m of b's
    features, whose cells are `order` (m,) from `start` (cells + 1,) on (see Searchable). lens: fx fy cx cy; noise of a
    depth reading: a_m, b_per_m, z0_m (see DepthNoise).
    """
    rows = (start.shape[0] - 1) // columns
    found, T = np.full(p_a.shape[0], -1), T_b_a
    for k in range(p_a.shape[0]):
        x, y, z = p_a[k, 0], p_a[k, 1], p_a[k, 2]
        depth = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        if depth <= NEAR_M:
            continue
        u = lens[0] * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / depth + lens[2]
        v = lens[1] * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / depth + lens[3]
        left, right = int(np.floor((u - radius_px) / CELL_PX)), int(np.floor((u + radius_px) / CELL_PX))
        top, bottom = int(np.floor((v - radius_px) / CELL_PX)), int(np.floor((v + radius_px) / CELL_PX))
        if right < 0 or bottom < 0 or left >= columns or top >= rows:
            continue
        tolerance_m = 6 * (noise[0] + noise[1] * (depth - noise[2]) ** 2) + 0.05 * depth
        best: float | np.int32 = max_distance2
        which = -1
        for row in range(max(top, 0), min(bottom, rows - 1) + 1):
            first = start[row * columns + max(left, 0)]
            last = start[row * columns + min(right, columns - 1) + 1]
            for at in range(first, last):
                b = order[at]
                if (px_b[b, 0] - u) ** 2 + (px_b[b, 1] - v) ** 2 > radius_px * radius_px:
                    continue
                if abs(z_b[b] - depth) > tolerance_m:
                    continue
                distance = squared_distance(descriptors_a[k], descriptors_b[b])
                if distance < best:
                    best, which = distance, b
        found[k] = which
    return found


def agreed(forward: Ints, backward: Ints) -> Ints:
    """Pairs (m, 2) from the results of both directions that no other result contradicts, sorted.

    A result is a feature of the other scan, or -1; forward (n,) and backward (m,) are for the first features only.
    """
    a, b = np.flatnonzero(forward >= 0), np.flatnonzero(backward >= 0)
    answered = backward[b] < len(forward)
    answered[answered] = forward[backward[b[answered]]] == b[answered]
    b = b[~answered]
    pairs = np.concatenate([np.stack([a, forward[a]], axis=1), np.stack([backward[b], b], axis=1)])
    once = [np.bincount(side, minlength=1)[side] == 1 for side in pairs.T]
    pairs = pairs[once[0] & once[1]]
    return pairs[np.argsort(pairs[:, 0])]
