"""The upward direction of a world: z where gravity levelled it, else estimated from the way people hold cameras."""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.typing import Floats

Z_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])  # to y up
LEVEL_RATIO = 4.0  # x axes give the vertical if they spread so many times more in the plane than out of it


def up_direction(T_world_cam: Floats, leveled: bool = False) -> Floats:
    """(3,) unit vector that points up, for (n, 4, 4) cameras; z where the result is `leveled` by gravity.

    People hold cameras with the x axis level. Up is therefore the direction of least spread of the x axes, if the
    cameras turn enough to show it; else it is opposite to the mean of the y axes, which point down.
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


def to_y_up(T_world_cam: Floats, leveled: bool = False) -> Floats:
    """(4, 4) rotation of a world, seen by (n, 4, 4) cameras, to glTF's axes: y up, and most cameras look along -z."""
    if leveled:
        return Z_UP
    y = up_direction(T_world_cam)
    forward = T_world_cam[:, :3, 2].mean(axis=0) if len(T_world_cam) else np.array([0.0, 0.0, 1.0])
    x = np.cross(forward, y)
    if np.linalg.norm(x) < 1e-6:
        x = np.cross(np.eye(3)[np.abs(y).argmin()], y)
    x /= np.linalg.norm(x)
    return se3.pose(np.stack([x, y, np.cross(x, y)]), np.zeros(3))


def smallest_turn(a: Floats, b: Floats) -> Floats:
    """(3, 3) the smallest rotation that takes the unit vector a to b."""
    axis, cosine = np.cross(a, b), float(a @ b)
    if cosine < -1 + 1e-9:
        return se3.exp_so3(np.pi * np.linalg.svd(a[None])[2][1])
    W = se3.hat(axis)
    return np.eye(3) + W + W @ W / (1 + cosine)
