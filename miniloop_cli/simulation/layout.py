"""The rooms of a building, their doors, and the order of the walk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miniloop_cli.typing import Floats

ROOM_M = np.array([4.6, 3.8, 2.5])
SECOND_ROOM_M = np.array([30.0, 0.0, 0.0])  # of scene "two-rooms", out of sight of the first
WALL_M = 0.12
TABLE_M = 0.75  # height of the turntable
DOOR_M = np.array([1.0, 2.05])  # width, height

Cell = tuple[int, int]  # column, row
SIDES: tuple[Cell, ...] = ((-1, 0), (1, 0), (0, -1), (0, 1))


@dataclass(frozen=True)
class Layout:
    """Rooms in two rows, numbered along the first row and back along the second.

    The walk visits them in this order and ends in room 0. With an odd number, the last room of the first row has only
    one door.
    """

    rooms: int

    @property
    def _columns(self) -> int:
        return (self.rooms + 1) // 2

    def cell(self, room: int) -> Cell:
        """Column and row of a room."""
        return (room, 0) if room < self._columns else (self.rooms - 1 - room, 1)

    def room_at(self, cell: Cell) -> int | None:
        """The room of a cell, None outside of the building."""
        return next((room for room in range(self.rooms) if self.cell(room) == cell), None)

    def centre_m(self, room: int) -> Floats:
        """(3,) the middle of a room's floor."""
        return np.array([*(self.cell(room) * (ROOM_M[:2] + WALL_M)), 0.0])

    @property
    def walk(self) -> list[int]:
        """Rooms in the order in which they are entered, from room 0 to room 0."""
        dead_end = [self._columns - 2] if self.rooms % 2 and self.rooms > 1 else []
        return [*range(self._columns), *dead_end, *range(self._columns, self.rooms), 0]

    def has_door(self, room: int, side: Cell) -> bool:
        """Whether a door leads from a room to the one beside it."""
        column, row = self.cell(room)
        other = self.room_at((column + side[0], row + side[1]))
        steps = list(zip(self.walk[:-1], self.walk[1:], strict=True))
        return (room, other) in steps or (other, room) in steps

    @property
    def blank_m(self) -> Floats:
        """(4,) x_low, y_low, x_high, y_high of the end of a room without texture and without a door."""
        centre, half = self.centre_m(self._columns - 1), ROOM_M / 2
        x, y = centre[:2]
        return np.array([x + 0.3, y - half[1] - WALL_M / 2, x + half[0] + WALL_M / 2, y + half[1] + WALL_M / 2])
