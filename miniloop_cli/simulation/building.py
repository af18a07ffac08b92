"""The scene of a recording: one room, two far apart, or several joined by doors."""

from __future__ import annotations

from copy import deepcopy
from functools import cache

import numpy as np
from numpy.random import Generator

from miniloop_cli.geometry import se3
from miniloop_cli.simulation.furniture import CEILING, FLOOR, furnish, goods_paint, room_paint
from miniloop_cli.simulation.layout import DOOR_M, ROOM_M, SECOND_ROOM_M, SIDES, TABLE_M, WALL_M, Cell, Layout
from miniloop_cli.simulation.scene import Paint, Scene
from miniloop_cli.simulation.symmetry import make_symmetric, symmetric_paint
from miniloop_cli.typing import Bytes, Floats

ROOM, T_WORLD_ROOM = 0, se3.pose(np.eye(3), np.array([0, 0, ROOM_M[2] / 2]))  # the box of a single room
SAME_FURNITURE = 25  # the seed of furniture that is the same for all seeds
UNSEEN: tuple[Bytes, float] = np.full((4, 4, 3), 128, np.uint8), 1.0


def build_scene(kind: str, rng: Generator, rooms: int = 1, blank: bool = False, alike: str = "nothing") -> Scene:
    """The scene of a name in `settings.SCENES`; `blank` leaves the end of one room without texture."""
    scene, layout = Scene(), Layout(rooms)
    if rooms > 1 and alike == "rooms":
        of_walls, of_furniture = rng.spawn(2)
        paint = cache(room_paint(kind, of_walls))  # each size of a face is painted once, for all rooms
        for room in range(rooms):
            _add_joined_room(scene, layout, room, paint)
            furnish(scene, layout.centre_m(room), kind, deepcopy(of_furniture), SIDES)
    elif rooms > 1:
        for room, own in enumerate(rng.spawn(rooms)):
            _add_joined_room(scene, layout, room, room_paint(kind, own))
            doors = [side for side in SIDES if layout.has_door(room, side)]
            furnish(scene, layout.centre_m(room), kind, own, doors)
    elif kind == "turntable":
        _add_turntable(scene, rng, alike == "half-turn")
    else:
        goods = np.random.default_rng(SAME_FURNITURE) if alike == "furniture" else rng
        _add_room(scene, np.zeros(3), kind, rng, goods, alike == "half-turn")
        if kind == "two-rooms":
            _add_room(scene, SECOND_ROOM_M, kind, rng, rng)
    if blank:
        scene.blank_m.append(layout.blank_m)
    return scene


def _add_room(
    scene: Scene, offset_m: Floats, kind: str, rng: Generator, goods: Generator, symmetric: bool = False
) -> None:
    """A closed room: a box that is seen from within; `rng` makes its walls, `goods` its furniture."""
    half, paint = ROOM_M / 2, room_paint(kind, rng, posters=5)
    paint = symmetric_paint(paint) if symmetric else paint
    scene.add_box(offset_m + np.array([0, 0, half[2]]), half, 0.0, paint, from_within=True)
    if kind != "plane":
        furnish(scene, offset_m, kind, goods)
    if symmetric:
        make_symmetric(scene, first=1)


def _add_turntable(scene: Scene, rng: Generator, symmetric: bool) -> None:
    """A bare room, and in its middle a board with a box on it."""
    _add_room(scene, np.zeros(3), "plane", rng, rng)
    goods, own = goods_paint("turntable", rng), symmetric_paint if symmetric else lambda paint: paint
    scene.add_box(np.array([0, 0, TABLE_M - 0.01]), np.array([0.32, 0.32, 0.01]), 0.0, own(goods))
    scene.add_box(np.array([0, 0, TABLE_M + 0.07]), np.array([0.11, 0.07, 0.07]), 0.3, own(goods))


def _add_joined_room(scene: Scene, layout: Layout, room: int, paint: Paint) -> None:
    """A room with doors, of slabs: floor, ceiling and walls. The first of two rooms makes the wall between them."""
    centre = layout.centre_m(room)
    half = np.array([*(ROOM_M[:2] + WALL_M) / 2, WALL_M / 2])
    for z, seen, role in ((-half[2], 5, FLOOR), (ROOM_M[2] + half[2], 4, CEILING)):
        scene.add_box(np.array([*centre[:2], z]), half, 0.0, _only((seen,), paint, role))
    column, row = layout.cell(room)
    for side in SIDES:
        other = layout.room_at((column + side[0], row + side[1]))
        if other is None or room < other:
            _add_wall(scene, centre, side, other is not None, layout.has_door(room, side), paint)


def _add_wall(scene: Scene, centre_m: Floats, side: Cell, two_sided: bool, door: bool, paint: Paint) -> None:
    """The wall on one side of a room; with a door in its middle: left of it, right of it and above it."""
    axis = 0 if side[0] else 1
    length, height = ROOM_M[1 - axis] + WALL_M, ROOM_M[2]
    pieces = [(0.0, length, 0.0, height)]  # middle along the wall, length, lowest, highest
    if door:
        beside = (length - DOOR_M[0]) / 2
        pieces = [(sign * (beside + DOOR_M[0]) / 2, beside, 0.0, height) for sign in (-1, 1)]
        pieces.append((0.0, DOOR_M[0], DOOR_M[1], height))
    toward = np.array([*side, 0.0])
    faces = [2 * axis, 2 * axis + 1]
    inner = faces[0] if toward[axis] > 0 else faces[1]
    seen = (*(faces if two_sided else [inner]), *((2 - 2 * axis, 3 - 2 * axis, 4) if door else ()))
    for middle, width, low, high in pieces:
        half = np.array([0.0, 0.0, (high - low) / 2])
        half[axis], half[1 - axis] = WALL_M / 2, width / 2
        centre = centre_m + toward * (ROOM_M / 2 + WALL_M / 2) * [1, 1, 0] + [0, 0, (low + high) / 2]
        centre[1 - axis] += middle
        scene.add_box(centre, half, 0.0, _only(seen, paint, None))


def _only(seen: tuple[int, ...], paint: Paint, role: int | None) -> Paint:
    """Paint for the visible faces by their role (FLOOR, CEILING; None: walls); the others have tiny textures."""

    def faces(face: int, width_m: float, height_m: float) -> tuple[Bytes, float]:
        return paint(0 if role is None else role, width_m, height_m) if face in seen else UNSEEN

    return faces
