"""One coloured cloud from many scans: the mean of the points in each voxel, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.errors import MiniloopError
from miniloop_cli.typing import Bytes, Floats, Floats32, Ints

BITS = 21  # of a voxel coordinate within an int64 key
HALF = 1 << (BITS - 1)
MASK = (1 << BITS) - 1

Keys = Ints
Sums = Floats  # (n, 7): x y z r g b, number of points


class VoxelCloud:
    """Running means of position and colour by voxel.

    Memory is at most about five times 64 bytes a voxel. When more than `max_voxels` are filled, the voxel size
    (`voxel_m`) doubles, so that a long recording gives a coarser cloud instead of none. Raises ValueError for sizes
    that are not positive.
    """

    def __init__(self, voxel_m: float = 0.01, max_voxels: int = 5_000_000) -> None:
        if not voxel_m > 0 or max_voxels < 1:
            raise ValueError(f"voxel_m and max_voxels must be positive, got {voxel_m} and {max_voxels}")
        self.voxel_m, self.max_voxels = float(voxel_m), int(max_voxels)
        self._whole: tuple[Keys, Sums] = np.empty(0, np.int64), np.empty((0, 7))
        self._pending: list[tuple[Keys, Sums]] = []

    def add(self, points_world: NDArray[np.floating], colors: Bytes) -> None:
        """Add (n, 3) points (m) with (n, 3) RGB; points that are not finite are left out.

        Raises MiniloopError for points more than a million voxels from the origin.
        """
        points = np.asarray(points_world, float).reshape(-1, 3)
        finite = np.isfinite(points).all(axis=1)
        points, colors = points[finite], np.asarray(colors).reshape(-1, 3)[finite]
        if not len(points):
            return
        if np.abs(points).max() >= self.voxel_m * (HALF - 1):
            raise MiniloopError(
                f"a point is {np.abs(points).max():.0f} m from the origin, beyond the {self.voxel_m * HALF:.0f} m "
                f"that voxels of {self.voxel_m:g} m reach: choose larger voxels"
            )
        keys = pack(np.floor(points / self.voxel_m).astype(np.int64))
        self._pending.append(merge(keys, np.column_stack([points, colors, np.ones(len(points))])))
        # Waiting until there is half as much as the whole keeps the total work near n log n, and the memory bounded.
        if 2 * sum(len(part_keys) for part_keys, _ in self._pending) >= len(self._whole[0]):
            self._join()

    def result(self, min_points: int = 1) -> tuple[Floats32, Bytes]:
        """(n, 3) points and (n, 3) colours, in voxel order; voxels of fewer than `min_points` readings left out."""
        self._join()
        sums = self._whole[1]
        sums = sums[sums[:, 6] >= min_points]
        means = sums[:, :6] / sums[:, 6:]
        return means[:, :3].astype(np.float32), np.rint(means[:, 3:]).astype(np.uint8)

    def _join(self) -> None:
        self._whole, self._pending = joined([self._whole, *self._pending]), []
        while len(self._whole[0]) > self.max_voxels:
            self.voxel_m *= 2
            keys, sums = self._whole
            self._whole = merge(pack(unpack(keys) >> 1), sums)


def pack(voxels: Ints) -> Keys:
    """(n, 3) voxel coordinates, each in [-2^20, 2^20), to (n,) keys."""
    v = voxels + HALF
    return (v[:, 0] << 2 * BITS) | (v[:, 1] << BITS) | v[:, 2]


def unpack(keys: Keys) -> Ints:
    """Voxels (n, 3) of keys (n,): the inverse of `pack`."""
    return np.stack([keys >> 2 * BITS, (keys >> BITS) & MASK, keys & MASK], axis=1) - HALF


def merge(keys: Keys, sums: Sums) -> tuple[Keys, Sums]:
    """Add up the rows (n, 7) of equal keys (n,); the resulting keys are sorted and unique."""
    unique, rows = np.unique(keys, return_inverse=True)
    columns = [np.bincount(rows, sums[:, c], len(unique)) for c in range(sums.shape[1])]
    return unique, np.stack(columns, axis=1)


def joined(parts: Sequence[tuple[Keys, Sums]]) -> tuple[Keys, Sums]:
    """`merge` of the results of several merges: the first one, the largest, is changed in place.

    Its keys (n,) are sorted, so that the others need only be looked up there.
    """
    (keys, sums), more = parts[0], parts[1:]
    if not more:
        return keys, sums
    other_keys, other_sums = merge(*(np.concatenate(columns) for columns in zip(*more, strict=True)))
    at = np.searchsorted(keys, other_keys)
    known = np.append(keys, -1)[at] == other_keys
    sums[at[known]] += other_sums[known]
    place = at[~known] + np.arange(np.count_nonzero(~known))
    return inserted(keys, place, other_keys[~known]), inserted(sums, place, other_sums[~known])


def inserted(rows: NDArray[Any], place: Ints, new: NDArray[Any]) -> NDArray[Any]:
    """Rows (n, ...) with `new` ones (m, ...) among them, which come to stand at place (m,), ascending."""
    found = np.empty((len(rows) + len(new), *rows.shape[1:]), rows.dtype)
    old = np.ones(len(found), bool)
    old[place] = False
    found[place], found[old] = new, rows
    return found


def fuse_cloud(
    chunks: Iterable[tuple[NDArray[np.floating], Bytes]],
    voxel_m: float = 0.01,
    max_voxels: int = 5_000_000,
    min_points: int = 1,
) -> tuple[Floats32, Bytes]:
    """Voxel-filtered cloud of all (points_world (n, 3), colors (n, 3)) chunks; see VoxelCloud."""
    cloud = VoxelCloud(voxel_m, max_voxels)
    for points_world, colors in chunks:
        cloud.add(points_world, colors)
    return cloud.result(min_points)
