"""Which way is up in the world of a result."""

from __future__ import annotations

import numpy as np

from miniloop_cli.typing import Floats

LEVEL_RATIO = 4.0  # the horizontal spread of the cameras' x axes must exceed the rest so much to tell the vertical


def up_direction(T_world_cam: Floats, leveled: bool = False) -> Floats:
    """(3,) unit vector that points up, for (n, 4, 4) cameras; z where the result is `leveled` by gravity.

    Who holds a camera keeps its x axis level: up is the direction that the x axes have least of, if they turn enough
    to tell it; else against the mean of the y axes, which point down.
    """
    if leveled:
        return np.array([0.0, 0.0, 1.0])
    if not len(T_world_cam):
        return np.array([0.0, -1.0, 0.0])
    x, down = T_world_cam[:, :3, 0], T_world_cam[:, :3, 1].mean(axis=0)
    length = float(np.linalg.norm(down))
    mean = -down / length if length > 1e-6 else np.array([0.0, -1.0, 0.0])
    values, vectors = np.linalg.eigh(x.T @ x / len(x))
    if values[1] < LEVEL_RATIO * values[0] + 0.02:
        return mean
    up = vectors[:, 0] * np.sign(vectors[:, 0] @ mean or 1.0)
    return np.asarray(up if up @ mean > 0.5 else mean, float)
