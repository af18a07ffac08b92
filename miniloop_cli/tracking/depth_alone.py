"""The motion between two surfaces; by depth alone where brightness misleads.

It does where the light changes at once, and where something stands still on the sensor: a fixed pattern in the dark,
dirt, a text in the image.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from miniloop_cli.scene.partial_motion import PartialMotion, closed
from miniloop_cli.tracking.motion import MAX_CHI2, contradiction
from miniloop_cli.tracking.surface import Surface, SurfaceMotion, surface_motion
from miniloop_cli.typing import Floats

MIN_OVERLAP, MIN_FITTING = 0.75, 0.9  # stricter than with brightness, as shapes alone are more alike


class Seen(NamedTuple):
    """The motion that surfaces tell, None if they do not fit; whether what stands still in the image is not of the
    scene, as depth shows that the camera moved."""

    motion: SurfaceMotion | None
    on_sensor: bool


def seen_motion(key: Surface, now: Surface, start: Floats, still: bool) -> Seen:
    """The motion since the keyframe, searched near `start` (4, 4), T_cam_key; `still`: points stand still.

    Where brightness does not fit, depth must tell all directions. Where depth contradicts what stands still, brightness
    stands still with it, and does not count.
    """
    both = surface_motion(key, now, start)
    if both is None:
        alone = _by_depth(key, now, start)
        return Seen(alone if alone and closed(alone.information) else None, False)
    if still and contradiction(np.eye(4), PartialMotion(both.T_cam_key, both.information)) > MAX_CHI2:
        return Seen(_by_depth(key, now, start), True)
    return Seen(both, False)


def _by_depth(key: Surface, now: Surface, start: Floats) -> SurfaceMotion | None:
    return surface_motion(_without_brightness(key), _without_brightness(now), start, MIN_OVERLAP, MIN_FITTING)


def _without_brightness(surface: Surface) -> Surface:
    return replace(surface, gray=np.zeros_like(surface.gray), slopes=np.zeros_like(surface.slopes))
