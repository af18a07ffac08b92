"""Paint and furniture of rooms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from miniloop_cli.simulation import texture
from miniloop_cli.simulation.layout import DOOR_M, ROOM_M, Cell
from miniloop_cli.simulation.scene import Paint, Scene
from miniloop_cli.typing import Bytes, Floats

FLOOR, CEILING = 4, 5  # faces of a room seen from within; the others are walls
POSTERS_PER_M = 1.2
DOORWAY_M = DOOR_M[0] / 2 + 0.4  # distance of furniture from the line through a door


def _size_px(width_m: float, height_m: float, density: float) -> tuple[int, int]:
    return max(int(height_m * density), 4), max(int(width_m * density), 4)


def _unpainted(kind: str, h: int, w: int, density: float, level: int) -> Bytes | None:
    """The face of a scene without texture, or with a repeated one; None if each face has its own."""
    if kind == "textureless":
        return np.full((h, w, 3), level, np.uint8)
    return texture.repeated(h, w, density) if kind == "repeated" else None


def room_paint(kind: str, rng: Generator, posters: int | None = None) -> Paint:
    """Paint for walls, floor and ceiling, with `posters` a wall; None: as many as fit."""

    def paint(face: int, width_m: float, height_m: float) -> tuple[Bytes, float]:
        density = 280.0
        h, w = _size_px(width_m, height_m, density)
        if (bare := _unpainted(kind, h, w, density, 170)) is not None:
            return bare, density
        if face == FLOOR:
            image = texture.surface(h, w, rng, 22, texture.color(rng, 90, 150))
            texture.add_shapes(image, 90, rng, 40)
            return image, density
        count = max(round(POSTERS_PER_M * width_m), 1) if posters is None else posters
        return texture.wall(h, w, density, rng, posters=1 if face == CEILING else count), density

    return paint


def goods_paint(kind: str, rng: Generator) -> Paint:
    """Paint for furniture and objects on it."""

    def paint(face: int, width_m: float, height_m: float) -> tuple[Bytes, float]:
        density = 400.0
        h, w = _size_px(width_m, height_m, density)
        if (bare := _unpainted(kind, h, w, density, 140)) is not None:
            return bare, density
        image = texture.surface(h, w, rng, 28, texture.color(rng, 70, 200))
        texture.add_shapes(image, int(60 * width_m * height_m) + 6, rng, int(min(h, w) / 2) + 5)
        if rng.random() < 0.5 and min(h, w) > 80:
            sheet = texture.poster(int(0.6 * h), int(0.7 * w), rng)
            image[h // 6 : h // 6 + sheet.shape[0], w // 6 : w // 6 + sheet.shape[1]] = sheet
        return image, density

    return paint


def furnish(scene: Scene, offset_m: Floats, kind: str, rng: Generator, doors: Sequence[Cell] = ()) -> None:
    """Add furniture along the walls of a room around (offset, z up), with objects on top, not before `doors` (sides).

    The middle, where the camera moves, stays free.
    """
    goods, half, count = goods_paint(kind, rng), ROOM_M / 2, 12
    for k in range(count):
        angle = 2 * np.pi * (k + rng.uniform(-0.25, 0.25)) / count
        direction = np.array([np.cos(angle), np.sin(angle)])
        extent = rng.uniform([0.15, 0.15, 0.12], [0.32, 0.3, 0.5])
        reach = (np.min((half[:2] - 0.05) / np.maximum(np.abs(direction), 1e-9))) - np.hypot(*extent[:2])
        centre = direction * reach * rng.uniform(0.88, 1.0)
        if any(_before(centre, side, np.hypot(*extent[:2])) for side in doors):
            continue
        scene.add_box(offset_m + np.array([*centre, extent[2]]), extent, rng.uniform(0, np.pi), goods)
        on_top = offset_m + np.array([*centre, 2 * extent[2]])
        radius = rng.uniform(0.08, 0.14)
        above = on_top + np.array([0, 0, radius])
        if k % 3 == 0:
            ball, _ = goods(0, 4 * radius, 2 * radius)
            scene.add_sphere(above, radius, ball)
        elif k % 3 == 1:
            scene.add_box(above, np.array([1.2, 0.8, 1.0]) * radius, rng.uniform(0, np.pi), goods)


def _before(centre_m: Floats, side: Cell, reach_m: float) -> bool:
    """Whether an object of this reach blocks a door in the middle of a side."""
    toward = np.array(side, float)
    across = abs(centre_m[0] * toward[1] - centre_m[1] * toward[0])
    return bool(centre_m @ toward > 0 and across - reach_m < DOORWAY_M)


def add_figure(scene: Scene, rng: Generator) -> int:
    """Add a textured, movable figure of human size; returns the number of its box."""

    def clothes(face: int, width_m: float, height_m: float) -> tuple[Bytes, float]:
        image = texture.surface(int(300 * height_m), int(300 * width_m), rng, 35, texture.color(rng))
        texture.add_shapes(image, 50, rng, 40)
        return image, 300.0

    return scene.add_box(np.array([0, 0, 0.85]), np.array([0.21, 0.14, 0.85]), 0.0, clothes)
