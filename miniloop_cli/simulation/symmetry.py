"""Places that look the same after a rotation by 180 degrees about the vertical."""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.simulation.scene import Paint, Scene
from miniloop_cli.typing import Bytes

HALF_TURN = se3.pose(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


def symmetric_paint(paint: Paint) -> Paint:
    """Paint of one box with equal opposite sides, and a symmetric top and bottom."""
    sides: dict[int, tuple[Bytes, float]] = {}

    def painted(face: int, width_m: float, height_m: float) -> tuple[Bytes, float]:
        if face % 2 and face < 4:
            return sides[face - 1]
        image, density = sides[face] = paint(face, width_m, height_m)
        if face >= 4:
            half = image.shape[0] // 2
            image[-half:] = image[:half][::-1, ::-1]
        return image, density

    return painted


def make_symmetric(scene: Scene, first: int) -> None:
    """Keep the boxes from number `first` on that are on one side of the middle, and add their half-turned copies.

    Spheres are left out, as their texture would have to be rotated.
    """
    scene.sphere.clear()
    scene.sphere_texture.clear()
    one_side = [k for k in range(first, len(scene.half_m)) if np.linalg.inv(scene.T_box_world[k])[1, 3] > 0]
    kept = [*range(first), *one_side, *one_side]
    turned = [scene.T_box_world[k] @ HALF_TURN for k in one_side]
    scene.T_box_world[:] = [scene.T_box_world[k] for k in kept[: first + len(one_side)]] + turned
    scene.half_m[:] = [scene.half_m[k] for k in kept]
    scene.from_within[:] = [scene.from_within[k] for k in kept]
    scene.box_texture[:] = [scene.box_texture[k] for k in kept]
