"""Display poses of recordings that are not joined: beside each other, upright, as their relative pose is unknown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.upward import smallest_turn, up_direction
from miniloop_cli.typing import Floats, Ints

GAP = 0.15  # between pieces, of the size of the first one
MARGIN_M = 2.0  # extent of a model beyond its cameras


def set_down(trajectories: Sequence[Floats], piece: Ints) -> Floats:
    """(r, 4, 4) from the world of the `piece` (r,) of each recording, with poses (n, 4, 4), to the view.

    The first piece keeps its pose; each other one is turned upright and moved to the right of those before.
    """
    T_shown = np.tile(np.eye(4), (len(trajectories), 1, 1))
    first = _of(trajectories, piece, 0)
    up, centre = up_direction(first), first[:, :3, 3].mean(axis=0)
    size_m = float(np.linalg.norm(np.ptp(first[:, :3, 3], axis=0)))
    side = np.cross(up, first[:, :3, 2].mean(axis=0))
    if np.linalg.norm(side) < 1e-9:
        side = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    side = -side / np.linalg.norm(side)
    beside_m = size_m / 2 + MARGIN_M
    for number in range(1, int(piece.max(initial=0)) + 1):
        own = _of(trajectories, piece, number)
        R = smallest_turn(up_direction(own), up)
        at = own[:, :3, 3] @ R.T
        reach_m = float(np.linalg.norm(np.ptp(at, axis=0))) / 2 + MARGIN_M
        beside_m += GAP * size_m + reach_m
        T_shown[piece == number] = se3.pose(R, centre + beside_m * side - at.mean(axis=0))
        beside_m += reach_m
    return T_shown


def _of(trajectories: Sequence[Floats], piece: Ints, number: int) -> Floats:
    return np.concatenate([T for T, own in zip(trajectories, piece.tolist(), strict=True) if own == number])
