"""A scene of textured boxes (a room is a box seen from within) and spheres, as flat arrays for the renderer.

World: z up, the floor at z = 0, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.geometry import se3
from miniloop_cli.typing import Bytes, Floats

Paint = Callable[[int, float, float], tuple[Bytes, float]]  # face, width_m, height_m to texture and texels a metre

LIGHT = np.array([0.30, 0.50, 0.81])
LEVELS = 5  # of the texture pyramid


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
    blank_m: list[Floats] = field(default_factory=list)  # x_low, y_low, x_high, y_high of areas without texture

    def add_texture(self, image: Bytes, texel_per_m: float) -> int:
        """Store an image (h, w, 3) with its pyramid; returns its number."""
        import cv2

        # Every level must have exactly half the size of the one before, else the texture moves with the distance.
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
        paint: Paint,
        from_within: bool = False,
    ) -> int:
        """Add a box; `paint(face, width_m, height_m)`, faces -x +x -y +y -z +z, returns texture and texels a metre.

        centre_m (3,) in the world, half_m (3,) half of its edges, turned by `yaw_rad` about the vertical.
        """
        T_world_box = se3.pose(se3.exp_so3(np.array([0, 0, yaw_rad])), centre_m)
        self.T_box_world.append(se3.inverse(T_world_box))
        self.half_m.append(np.asarray(half_m, float))
        self.from_within.append(from_within)
        x, y, z = 2 * np.asarray(half_m, float)
        sizes = [(y, z), (y, z), (x, z), (x, z), (x, y), (x, y)]
        self.box_texture.append([self.add_texture(*paint(face, *size)) for face, size in enumerate(sizes)])
        return len(self.half_m) - 1

    def add_sphere(self, centre_m: Floats, radius_m: float, image: Bytes) -> None:
        """Add a sphere at centre_m (3,); its texture (h, w, 3) covers longitude and latitude."""
        x, y, z = map(float, centre_m)
        self.sphere.append((x, y, z, radius_m))
        self.sphere_texture.append(self.add_texture(image, image.shape[1] / (2 * np.pi * radius_m)))

    def arrays(self) -> tuple[NDArray, ...]:
        """All arrays (n, ...) of the render kernel, in its order."""
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
            np.array(self.blank_m, float).reshape(-1, 4),
        )
