"""The motion of a frame, from points, from depth and brightness, or from what both leave of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.scene.partial_motion import PartialMotion, closed
from miniloop_cli.scene.tracked import Link
from miniloop_cli.tracking.motion import Measured, Motion, frame_motion
from miniloop_cli.tracking.surface import SurfaceMotion
from miniloop_cli.typing import Floats

FEW_POINTS = 60  # with fewer, depth and brightness tell the motion better
CELLS_A_POINT = 100  # of a surface, as neighbouring cells share their errors
LAG_S = 0.02  # between a colour image and its depth image


class Choice(NamedTuple):
    """The link of a frame to its keyframe, None if nothing tells it; the motion of the points, None if they do not move
    together."""

    link: Link | None
    by_points: Motion | None


def few(motion: Motion | None) -> bool:
    """Whether too few points tell the motion to be used alone."""
    return motion is None or int(motion.agrees.sum()) < FEW_POINTS


def choose(points: Measured, motion: Motion | None, surface: SurfaceMotion | None, camera: Camera) -> Choice:
    """The best that is known of a motion: by points, their `motion` alone, and by depth and brightness.

    Many points are used alone. With few, depth and brightness tell the motion better, if they tell all directions; else
    each tells what the other leaves open. It is never guessed: directions that nothing tells have no information.
    """
    if surface is None or not few(motion):
        return Choice(_link(motion), motion)
    known = PartialMotion(surface.T_cam_key, surface.information)
    whole = bool(closed(surface.information))
    if not whole:
        motion = frame_motion(points, surface.T_cam_key, camera, known) or motion
    if whole or motion is None:
        return Choice(Link(*known, surface.cells // CELLS_A_POINT, known, by_surface=True), motion)
    return Choice(_link(motion, known), motion)


def _link(motion: Motion | None, surface: PartialMotion | None = None) -> Link | None:
    return motion and Link(motion.T_cam_key, motion.information, int(motion.agrees.sum()), surface)


def with_lag(information: Floats, step: Floats, elapsed_s: float) -> Floats:
    """The information (6, 6) of a motion by depth, where the depth image was taken up to LAG_S from its colour image.

    step (4, 4): motion of the camera in the last `elapsed_s` seconds; the velocity is assumed constant.
    """
    moved = np.linalg.norm([se3.log_so3(step[:3, :3]), step[:3, 3]], axis=1) * LAG_S / max(elapsed_s, LAG_S)
    late = np.repeat(moved**2, 3) + 1e-12
    return np.asarray(np.linalg.inv(np.linalg.inv(information + 1e-9 * np.eye(6)) + np.diag(late)))
