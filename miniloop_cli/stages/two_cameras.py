"""Stage: a colour camera and a separate depth camera, both roughly known, from some frames of the recording."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

from miniloop_cli.config import Settings
from miniloop_cli.datasets.own_cameras import with_camera
from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.refinement.two_cameras import TwoCameras
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.calibration import Calibration
from miniloop_cli.scene.registration import Registration, RegistrationError
from miniloop_cli.scene.sequence import DepthCamera, Sequence
from miniloop_cli.stages.depth_reader import depth_reader

LOG = logging.getLogger("miniloop")
FRAMES = 40  # more of them hardly make the cameras surer


def asks_for_two_cameras(sequence: Sequence, settings: Settings) -> bool:
    """Whether the depth camera of a recording is calibrated: if it is separate, and a guess (auto)."""
    if sequence.depth_camera is None or settings.refine != "bundle":
        return False
    guess = sequence.depth_camera.camera.trust == Trust.GUESS
    return settings.calibrate == "on" or (settings.calibrate == "auto" and guess)


def calibrate_two_cameras(
    sequence: Sequence,
    settings: Settings,
    workers: Workers,
    register: Callable[[Sequence, Settings, TwoCameras], Registration],
) -> Calibration | None:
    """Calibration of both cameras from evenly spaced frames, by `register`; None if they cannot be registered.

    Two fits: depth that is read beside its pixels gives few matches, and some wrong ones. With the cameras of the first
    fit the frames are matched again, and the same parameters are fitted to these matches.
    """
    assert sequence.depth_camera
    some = sequence.thinned(FRAMES)
    alone = settings.tracking.model_copy(update={"enabled": False})
    asking = settings.model_copy(update={"calibrate": "on", "tracking": alone})
    read_depth = depth_reader(some, settings.depth, workers)
    try:
        first = register(some, asking, TwoCameras(sequence.depth_camera, read_depth)).calibration
    except RegistrationError as error:
        LOG.warning("the depth camera stays as it was given: %s", error)
        return None
    if first is None or not first.changed:
        return first
    color, own = first.as_given
    assert own
    two = TwoCameras(own, read_depth, first.names_estimated)
    try:
        second = register(with_cameras(some, color, own), asking, two).calibration
    except RegistrationError as error:
        LOG.warning("the cameras are those of a first fit; a second fit failed: %s", error)
        return first
    if second is None or second.names_estimated != first.names_estimated:
        LOG.info("calibration: the second fit determines fewer parameters; the first one counts")
        return first
    return second.continues(first)


def with_cameras(sequence: Sequence, color: Camera, depth_camera: DepthCamera | None) -> Sequence:
    """The recording with another common camera and another depth camera."""
    return replace(with_camera(sequence, color), depth_camera=depth_camera)
