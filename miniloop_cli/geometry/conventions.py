"""Conventions of other tools, and poses in them as ours: camera x right, y down, z forward; poses camera to world.

Which convention some poses have is found from relative motions that are known otherwise. Relative motions do not
depend on the world frame, so no worlds need to be aligned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.typing import Floats, Ints

# Camera axes x right, y up, z backward (OpenGL, ARKit, Blender, nerfstudio) to ours, and ours to those: it is its own
# inverse. T_world_cam = T_world_gl @ OPENGL_AXES.
OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
MIRROR_Y = np.diag([1.0, -1.0, 1.0, 1.0])

LEAST_ROTATION_DEG, LEAST_TRANSLATION_M = 1.0, 0.01  # smaller motions are treated as noise


@dataclass(frozen=True)
class Convention:
    """Poses as some tool writes them. `ours`: (n, 4, 4) of them to T_world_cam."""

    words: str
    ours: Callable[[Floats], Floats]


def _w_first(T: Floats) -> Floats:
    """Poses whose quaternions w x y z were read as x y z w."""
    return se3.pose(se3.rotations(se3.quaternions(T[:, :3, :3]), w_first=True), T[:, :3, 3])


CONVENTIONS = {
    "camera-to-world": Convention("poses camera to world", lambda T: T),
    "world-to-camera": Convention("poses world to camera", se3.inverse),
    "opengl": Convention("camera axes x right, y up, z backward (ARKit, OpenGL)", lambda T: T @ OPENGL_AXES),
    "opengl-world-to-camera": Convention(
        "poses world to camera, camera axes x right, y up, z backward (OpenGL)", lambda T: se3.inverse(OPENGL_AXES @ T)
    ),
    "w-first": Convention("quaternions w x y z", _w_first),
    "w-first-world-to-camera": Convention(
        "poses world to camera, quaternions w x y z", lambda T: se3.inverse(_w_first(T))
    ),
    "left-handed": Convention("left-handed axes, y up (Unity, ICL-NUIM)", lambda T: MIRROR_Y @ T @ MIRROR_Y),
}


def motions(T_world_cam: Floats, i: Ints, j: Ints) -> Floats:
    """(m, 4, 4) T_j_i between the rows i (m,) and j (m,) of the poses (n, 4, 4)."""
    return se3.inverse(T_world_cam[j]) @ T_world_cam[i]


def length_ratio(given: Floats, known: Floats) -> float:
    """How many times as long (m, 4, 4) given motions are as the known ones; NaN where nothing moves."""
    lengths = [np.sqrt((T[:, :3, 3] ** 2).sum()) for T in (given, known)]
    return float(lengths[0] / lengths[1]) if lengths[1] > 0 else np.nan


def difference(given: Floats, known: Floats) -> float:
    """Median relative difference of (m, 4, 4) given motions from the known: 0 if equal, 1 as for no motion at all.

    Rotation and translation each count against their median size; a common factor of length does not count.
    """
    scale = length_ratio(given, known)
    scale = scale if np.isfinite(scale) and scale > 0 else 1.0
    R = np.swapaxes(given[:, :3, :3], 1, 2) @ known[:, :3, :3]
    t = given[:, :3, 3] / scale - known[:, :3, 3]
    turned = np.median(se3.rotation_angle_deg(known[:, :3, :3])) + LEAST_ROTATION_DEG
    moved = np.median(np.linalg.norm(known[:, :3, 3], axis=1)) + LEAST_TRANSLATION_M
    return float(np.median(np.hypot(se3.rotation_angle_deg(R) / turned, np.linalg.norm(t, axis=1) / moved)))
