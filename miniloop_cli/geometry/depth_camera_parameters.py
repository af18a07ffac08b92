"""The parameters of a separate depth camera that a calibration may change, and their effect on its readings.

The ray of a colour pixel meets the surface that the depth camera saw at the depth of the reading. A step of the
parameters moves every point of that surface by dS in the frame of colour. The ray then meets it at another depth,
  dz = dS_z - slope . du,  du = (fx (dS_x - x dS_z), fy (dS_y - y dS_z)) / z,
with the slope of the depth along the image (m/px): the surface shifts in the image, and another part of it is read.

Parameters that a recording does not determine are left out: a shift along the view, which acts as `offset_m` of the
depth model and the unit of length; and fy of depth against its fx.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.typing import Floats

# Relative step of the focal length (log); px; turn about the depth camera's own centre, by the axes of colour (rad);
# shift along these (m).
NAMES = ("depth_focal", "depth_cx", "depth_cy", "turn_x", "turn_y", "turn_z", "shift_x", "shift_y")


def moved(own: Camera, T_color_depth: Floats, step: Floats) -> tuple[Camera, Floats]:
    """The depth camera and its pose (4, 4) with the steps (8,) taken."""
    f = float(np.exp(step[0]))
    camera = replace(own, fx=own.fx * f, fy=own.fy * f, cx=own.cx + float(step[1]), cy=own.cy + float(step[2]))
    turn = se3.exp_so3(np.asarray(step[3:6], float))
    t = T_color_depth[:3, 3] + [step[6], step[7], 0.0]
    return camera, se3.pose(turn @ T_color_depth[:3, :3], t)


def steps_between(before: tuple[Camera, Floats], after: tuple[Camera, Floats]) -> Floats:
    """Steps (8,) from one depth camera and its pose (4, 4) to another: the inverse of `moved`."""
    (own, T), (now, T_now) = before, after
    turn = se3.log_so3(T_now[:3, :3] @ T[:3, :3].T)
    return np.array([
        np.log(now.fx / own.fx), now.cx - own.cx, now.cy - own.cy, *turn, *(T_now[:2, 3] - T[:2, 3])
    ])  # fmt: skip


def reading_slopes(X: Floats, slope: Floats, color: Camera, own: Camera, T_color_depth: Floats) -> Floats:
    """Derivatives (8, k) of the readings of surface points X (k, 3) m, in the frame of colour, by the steps.

    slope (k, 2) m/px: that of the depth along the image of colour.
    """
    R, t = T_color_depth[:3, :3], T_color_depth[:3, 3]
    seen = (X - t) @ R  # in the frame of the depth camera
    zero = np.zeros(len(X))
    move = np.zeros((len(NAMES), len(X), 3))
    move[0] = np.stack([-seen[:, 0], -seen[:, 1], zero], axis=1) @ R.T
    move[1] = np.stack([-seen[:, 2] / own.fx, zero, zero], axis=1) @ R.T
    move[2] = np.stack([zero, -seen[:, 2] / own.fy, zero], axis=1) @ R.T
    for axis in range(3):
        move[3 + axis] = np.cross(np.eye(3)[axis], X - t)
    move[6, :, 0] = move[7, :, 1] = 1.0
    z = X[:, 2]
    along_x = color.fx * (move[:, :, 0] - X[:, 0] / z * move[:, :, 2]) / z
    along_y = color.fy * (move[:, :, 1] - X[:, 1] / z * move[:, :, 2]) / z
    return np.asarray(move[:, :, 2] - slope[:, 0] * along_x - slope[:, 1] * along_y, float)
