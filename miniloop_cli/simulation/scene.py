"""A scene of textured boxes (a room is a box seen from within) and spheres, as flat arrays for the renderer.

World: z up, the floor at z = 0, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from miniloop_cli.geometry import se3
from miniloop_cli.simulation import texture
from miniloop_cli.typing import Bytes, Floats

ROOM_M = np.array([4.6, 3.8, 2.5])
LIGHT = np.array([0.30, 0.50, 0.81])
LEVELS = 5  # of the texture pyramid
SECOND_ROOM_M = np.array([30.0, 0.0, 0.0])


@dataclass
class Scene:
    """Boxes, spheres and their textures; everything is appended, then frozen by `arrays`."""

    T_box_world: list[Floats] = field(default_factory=list)
    half_m: list[Floats] = field(default_factory=list)
    from_within: list[bool] = field(default_factory=list)
    box_texture: list[list[int]] = field(default_factory=list)
    sphere: list[tuple[float, float, float, float]] = field(default_factory=list)  # centre, radius (m)
    sphere_texture: list[int] = field(default_factory=list)
    pyramids: list[list[Bytes]] = field(default_factory=list)
    texel_per_m: list[float] = field(default_factory=list)

    def add_texture(self, image: Bytes, texel_per_m: float) -> int:
        """Store an image with its pyramid; returns its number."""
        import cv2

        # Every level must be exactly half of the one before, or the texture slides over its surface with the distance.
        h, w = image.shape[:2]
        side = 1 << (LEVELS - 1)
        levels = [np.asarray(cv2.copyMakeBorder(image, 0, -h % side, 0, -w % side, cv2.BORDER_REPLICATE), np.uint8)]
        for _ in range(LEVELS - 1):
            h, w = levels[-1].shape[:2]
            half = cv2.resize(levels[-1], (w // 2, h // 2), interpolation=cv2.INTER_AREA)
            levels.append(np.asarray(half, np.uint8))
        self.pyramids.append(levels)
        self.texel_per_m.append(texel_per_m)
        return len(self.pyramids) - 1

    def add_box(
        self,
        centre_m: Floats,
        half_m: Floats,
        yaw_rad: float,
        paint: Callable[[int, float, float], tuple[Bytes, float]],
        from_within: bool = False,
    ) -> int:
        """Add a box; `paint(face, width_m, height_m)`, faces -x +x -y +y -z +z, returns texture and texels a metre."""
        T_world_box = se3.pose(se3.exp_so3(np.array([0, 0, yaw_rad])), centre_m)
        self.T_box_world.append(se3.inverse(T_world_box))
        self.half_m.append(np.asarray(half_m, float))
        self.from_within.append(from_within)
        x, y, z = 2 * np.asarray(half_m, float)
        sizes = [(y, z), (y, z), (x, z), (x, z), (x, y), (x, y)]
        self.box_texture.append([self.add_texture(*paint(face, *size)) for face, size in enumerate(sizes)])
        return len(self.half_m) - 1

    def add_sphere(self, centre_m: Floats, radius_m: float, image: Bytes) -> None:
        """Add a sphere; its texture is laid over longitude and latitude."""
        x, y, z = map(float, centre_m)
        self.sphere.append((x, y, z, radius_m))
        self.sphere_texture.append(self.add_texture(image, image.shape[1] / (2 * np.pi * radius_m)))

    def arrays(self) -> tuple[NDArray, ...]:
        """Everything the render kernel wants, in its order."""
        table, chunks, offset = np.zeros((len(self.pyramids), LEVELS, 3), np.int64), [], 0
        for number, levels in enumerate(self.pyramids):
            for level, image in enumerate(levels):
                table[number, level] = offset, image.shape[1], image.shape[0]
                chunks.append(image.reshape(-1))
                offset += image.size
        return (
            np.array(self.T_box_world).reshape(-1, 4, 4),
            np.array(self.half_m).reshape(-1, 3),
            np.array(self.from_within, bool),
            np.array(self.box_texture, np.int64).reshape(-1, 6),
            np.array(self.sphere, float).reshape(-1, 4),
            np.array(self.sphere_texture, np.int64),
            table,
            np.array(self.texel_per_m),
            np.concatenate(chunks),
            LIGHT,
        )


def build_scene(kind: str, rng: Generator) -> Scene:
    """The scene of a name in `settings.SCENES`."""
    scene = Scene()
    add_room(scene, np.zeros(3), kind, rng)
    if kind == "two-rooms":
        add_room(scene, SECOND_ROOM_M, kind, rng)
    return scene


def add_room(scene: Scene, offset_m: Floats, kind: str, rng: Generator) -> None:
    """One furnished room around (offset, z up): the middle, where the camera moves, is left free."""

    def size_px(width_m: float, height_m: float, density: float) -> tuple[int, int]:
        return max(int(height_m * density), 4), max(int(width_m * density), 4)

    def walls(face: int, width_m: float, height_m: float) -> tuple[Bytes, float]:
        density = 280.0
        h, w = size_px(width_m, height_m, density)
        if kind == "textureless":
            return np.full((h, w, 3), 170, np.uint8), density
        if kind == "repeated":
            return texture.repeated(h, w, density), density
        if face == 4:
            image = texture.surface(h, w, rng, 22, texture.color(rng, 90, 150))
            texture.add_shapes(image, 90, rng, 40)
            return image, density
        return texture.wall(h, w, density, rng, posters=5 if face < 4 else 1), density

    def goods(face: int, width_m: float, height_m: float) -> tuple[Bytes, float]:
        density = 400.0
        h, w = size_px(width_m, height_m, density)
        if kind == "textureless":
            return np.full((h, w, 3), 140, np.uint8), density
        if kind == "repeated":
            return texture.repeated(h, w, density), density
        image = texture.surface(h, w, rng, 28, texture.color(rng, 70, 200))
        texture.add_shapes(image, int(60 * width_m * height_m) + 6, rng, int(min(h, w) / 2) + 5)
        if rng.random() < 0.5 and min(h, w) > 80:
            sheet = texture.poster(int(0.6 * h), int(0.7 * w), rng)
            image[h // 6 : h // 6 + sheet.shape[0], w // 6 : w // 6 + sheet.shape[1]] = sheet
        return image, density

    half = ROOM_M / 2
    scene.add_box(offset_m + np.array([0, 0, half[2]]), half, 0.0, walls, from_within=True)
    if kind == "plane":
        return
    count = 12
    for k in range(count):  # furniture along the walls, with things on top
        angle = 2 * np.pi * (k + rng.uniform(-0.25, 0.25)) / count
        direction = np.array([np.cos(angle), np.sin(angle)])
        extent = rng.uniform([0.15, 0.15, 0.12], [0.32, 0.3, 0.5])
        reach = (np.min((half[:2] - 0.05) / np.maximum(np.abs(direction), 1e-9))) - np.hypot(*extent[:2])
        centre = direction * reach * rng.uniform(0.88, 1.0)
        scene.add_box(offset_m + np.array([*centre, extent[2]]), extent, rng.uniform(0, np.pi), goods)
        on_top = offset_m + np.array([*centre, 2 * extent[2]])
        radius = rng.uniform(0.08, 0.14)
        above = on_top + np.array([0, 0, radius])
        if k % 3 == 0:
            ball, _ = goods(0, 4 * radius, 2 * radius)
            scene.add_sphere(above, radius, ball)
        elif k % 3 == 1:
            scene.add_box(above, np.array([1.2, 0.8, 1.0]) * radius, rng.uniform(0, np.pi), goods)


def add_figure(scene: Scene, rng: Generator) -> int:
    """A textured figure of human size, to be moved; returns the number of its box."""

    def clothes(face: int, width_m: float, height_m: float) -> tuple[Bytes, float]:
        image = texture.surface(int(300 * height_m), int(300 * width_m), rng, 35, texture.color(rng))
        texture.add_shapes(image, 50, rng, 40)
        return image, 300.0

    return scene.add_box(np.array([0, 0, 0.85]), np.array([0.21, 0.14, 0.85]), 0.0, clothes)
