"""Points ordered so that every prefix is a coarse model of the whole, and the tiles of an octree over them.

Cells are those of an octree over the cube around the points. A point belongs to the coarsest level at which it is the
first of its cell in Morton order (Morton 1966). One sort gives all levels: the level is the highest one at which a
code differs from the one before.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.typing import Floats, Ints

BITS = 16  # of a coordinate within the cube; also the number of levels below the root
STEPS = (1 << BITS) - 1
FEW_POINTS = 3000  # a tile, on average: smaller tiles need too many requests
TILE_LEVELS = 7  # a tile holds a grid of 2^7 cells a side of its cube


@dataclass(frozen=True)
class Levels:
    """n points, coarse first. `order` (n,): rows of the given points; `level` (n,) ascending, 0 to BITS + 1.

    `steps` (n, 3) uint16: positions within the cube, p = corner + side / STEPS * steps. Within a level the points
    follow each other in Morton order.
    """

    order: Ints
    level: Ints
    steps: NDArray[np.uint16]
    corner: Floats
    side: float

    def __len__(self) -> int:
        return len(self.order)

    @property
    def spacing(self) -> float:
        """Distance of most neighbouring points, in steps."""
        return float(1 << BITS) / float(1 << int(np.median(self.level))) if len(self) else 1.0

    def first(self, count: int) -> Levels:
        """At most `count` points: the coarse levels whole, and evenly spaced ones of the level that does not fit."""
        if count >= len(self):
            return self
        last = int(self.level[count])
        begin, end = np.searchsorted(self.level, [last, last + 1])
        rows = np.r_[0:begin, begin + np.linspace(0, end - begin - 1, count - begin).astype(int)]
        return Levels(self.order[rows], self.level[rows], self.steps[rows], self.corner, self.side)


@dataclass(frozen=True)
class Tile:
    """Points begin..end - 1 of `tiled` levels: those of one cube of `depth`, `cell` (x, y, z) counted in its sides."""

    depth: int
    cell: tuple[int, int, int]
    begin: int
    end: int


def coarse_first(points: NDArray[np.floating]) -> Levels:
    """The (n, 3) points in levels. They must be finite."""
    points = np.asarray(points, float).reshape(-1, 3)
    if not len(points):
        none = np.zeros(0, np.int64)
        return Levels(none, none, np.zeros((0, 3), np.uint16), np.zeros(3), 1.0)
    corner = points.min(axis=0)
    side = max(float((points.max(axis=0) - corner).max()), 1e-9)
    steps = np.rint((points - corner) * (STEPS / side)).astype(np.uint64)
    codes = morton(steps)
    order = np.argsort(codes, kind="stable")
    level = _levels(codes[order])
    order, level = order[by := np.argsort(level, kind="stable")], level[by]
    return Levels(order, level, steps[order].astype(np.uint16), corner, side)


def morton(steps: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """(n,) codes of (n, 3) cells of BITS bits a coordinate: the bits of x, y and z in turn, the highest first."""
    codes = np.zeros(len(steps), np.uint64)
    for axis in range(3):
        bits = steps[:, axis]
        for shift, mask in ((16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)):
            bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
        codes |= bits << np.uint64(2 - axis)
    return codes


def _levels(codes: NDArray[np.uint64]) -> Ints:
    """(n,) level of each of the sorted codes: 0 for the first, BITS + 1 for one that equals its predecessor."""
    differ = codes[1:] ^ codes[:-1]
    # The exponent of a double is the place of the highest bit; 48 bits are exact.
    place = np.frexp(differ.astype(float))[1] - 1
    return np.r_[0, np.where(differ == 0, BITS + 1, BITS - place // 3)].astype(np.int64)


def tiles(levels: Levels, few: int = FEW_POINTS) -> tuple[Levels, list[Tile]]:
    """The points sorted by tile, coarse tiles first, and the tiles: the nodes of an octree as Potree's (Schütz 2016).

    The tile of a point of level k is TILE_LEVELS above it, so a tile adds points with distances of about 2^-TILE_LEVELS
    of its side to the coarser tiles around it; the deepest tiles contain all finer points.
    """
    codes = morton(levels.steps.astype(np.uint64))
    depth = np.clip(levels.level - TILE_LEVELS, 0, BITS - TILE_LEVELS)
    depth = np.minimum(depth, _deepest(codes, depth, few))
    node = codes >> (3 * (BITS - depth)).astype(np.uint64)
    order = np.lexsort((np.arange(len(levels)), node, depth))
    depth, node = depth[order], node[order]
    changes = np.flatnonzero((np.diff(depth) != 0) | (np.diff(node) != 0)) + 1
    steps = levels.steps[order]
    found = []
    for begin, end in itertools.pairwise([0, *changes.tolist(), len(levels)] if len(levels) else []):
        x, y, z = (int(step) >> (BITS - int(depth[begin])) for step in steps[begin])
        found.append(Tile(int(depth[begin]), (x, y, z), begin, end))
    return Levels(levels.order[order], levels.level[order], steps, levels.corner, levels.side), found


def _deepest(codes: NDArray[np.uint64], depth: Ints, few: int) -> int:
    """The depth below which tiles would hold fewer than `few` points on average."""
    for deeper in range(1, int(depth.max(initial=0)) + 1):
        own = codes[depth >= deeper] >> np.uint64(3 * (BITS - deeper))
        if len(own) < few * len(np.unique(own)):
            return deeper - 1
    return BITS - TILE_LEVELS
