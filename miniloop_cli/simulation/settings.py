"""The settings of a simulated recording."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace

import numpy as np

from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import PINHOLE, radial_tangential_lens
from miniloop_cli.scene.sequence import DepthCamera

SCENES = ("room", "two-rooms", "plane", "textureless", "repeated", "turntable")
PATHS = ("loop", "xyz", "rotation", "still", "random-walk")
ALIKE = ("nothing", "half-turn", "rooms", "furniture")
HARD = ("blank", "dark", "blur", "covered", "doubled", "frozen", "swapped", "unsorted", "broken", "missing")
MIN_FRAMES_A_STRETCH = 10
TURN_AXIS = np.array([2.0, 3.0, -1.0]) / np.sqrt(14.0)  # rotation axis of a depth camera against colour


@dataclass(frozen=True)
class SimulationSettings:
    """A simulated recording: scene, camera path and sensor.

    Scenes: `room` (furnished, textured), `two-rooms` (half of the frames in each, no overlap), `plane` (one wall
    fills the view), `textureless` (the room without any texture), `repeated` (the same tile on everything),
    `turntable` (a box on a board that turns in front of a static camera; poses are in the frame of the board, in which
    the room turns; path `loop` only).
    Paths: `loop` (a little over one turn, with the same start and end), `xyz` (translations in front of one wall, every
    pair overlaps), `rotation` (no translation), `still`, `random-walk` (smooth and different for every seed).

    `alike` places: with `half-turn` a room, or a board and its box, look the same when they are turned by 180 degrees
    about the vertical; with `rooms` all rooms have the same walls and furniture; with `furniture` the room has the
    same furniture in the same places for every seed, but other walls.

    At each of the evenly spread `cuts`, a part of the path is left out without a gap in the stamps.

    Several `rooms` are joined by doors; `loop` then visits all of them and ends in the first. Any number of frames
    covers the whole walk; it has a person's pace if frames / `rate_hz` is about `simulation.tour.duration_s`.

    Stretches of `hard`, in this order, each in the middle of its share of the recording (a name may be repeated):

    - `blank`: one end of a room has no texture; the stretch is whenever the camera looks there.
    - `dark`: the light decreases until the image is black, and returns; the noise increases; depth is unchanged.
    - `blur`: the hand shakes, with the exposure nearly as long as the time between two frames.
    - `covered`: the lens is covered: black images, and no depth.
    - `doubled`: every other frame is a copy of the one before it.
    - `frozen`: the same frame is repeated.
    - `swapped`: every other frame is exchanged with the next one; the stamps are not.
    - `unsorted`: the tables list the frames backwards, with right stamps.
    - `broken`: the files of colour images are truncated.
    - `missing`: no frames are recorded.
    """

    frames: int = 30
    width: int = 640
    height: int = 480
    scene: str = "room"
    path: str = "loop"
    noise: bool = True  # depth noise, disparity steps, holes, colour noise
    noise_level: float = 1.0  # times the noise of a Kinect, in depth and in colour
    moving_object: bool = False  # a figure that walks in front of the camera, about a third of the image
    masks: bool = False  # also write mask/: the pixels of the moving object
    depth_limit_m: float = 5.0  # no readings beyond
    exposure: float = 1.0  # gain of the image; 3 saturates most of it
    blur_s: float = 0.0  # exposure time: motion during it blurs the colour image
    rolling_shutter_s: float = 0.0  # time between the first and the last row of an image
    rate_hz: float = 10.0
    path_share: float = 1.0  # only the first part of the path is walked, more slowly
    focal_px: float | None = None  # None: 525 px at a width of 640
    accelerometer: bool = False  # also write accelerometer.txt, at 100 Hz, with noise and bias
    rooms: int = 1
    alike: str = "nothing"
    cuts: int = 0
    hard: tuple[str, ...] = ()
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)  # k1 k2 p1 p2 k3
    depth_baseline_m: float = 0.0  # from the colour camera to a separate depth camera, to the left
    depth_turn_deg: float = 0.0  # of that camera against the colour camera
    depth_focal_px: float | None = None  # of that camera; None: as the colour camera

    def __post_init__(self) -> None:
        given = [("scene", self.scene, SCENES), ("path", self.path, PATHS), ("alike places", self.alike, ALIKE)]
        for key, value, known in (*given, *(("hard stretch", each, HARD) for each in self.hard)):
            if value not in known:
                near = difflib.get_close_matches(value, known, n=1)
                hint = f"did you mean '{near[0]}'?" if near else f"choose one of {', '.join(known)}"
                raise ConfigError(f"unknown {key} '{value}'; {hint}")
        for key, low, high in (
            ("frames", 1, 100_000),
            ("width", 32, 4096),
            ("height", 32, 4096),
            ("depth_limit_m", 0.5, 13.0),  # 16 bits at 5000 units a metre end at 13.1 m
            ("exposure", 0.01, 100.0),
            ("blur_s", 0.0, 10.0),
            ("rolling_shutter_s", 0.0, 10.0),
            ("rate_hz", 0.1, 1000.0),
            ("path_share", 1e-4, 1.0),
            ("noise_level", 0.0, 20.0),
            ("rooms", 1, 100),
            ("cuts", 0, 100),
            ("depth_baseline_m", 0, 0.5),
            ("depth_turn_deg", 0, 10),
        ):
            if not low <= getattr(self, key) <= high:
                raise ConfigError(f"{key} must be from {low:g} to {high:g}, not {getattr(self, key)}")
        if self.scene == "turntable" and (self.path != "loop" or self.moving_object):
            raise ConfigError("scene 'turntable' needs path 'loop' and no walking figure")
        if self.alike == "half-turn" and (self.rooms > 1 or self.scene not in ("room", "turntable")):
            raise ConfigError("alike 'half-turn' needs one room or a turntable")
        if self.alike == "furniture" and (self.rooms > 1 or self.scene != "room"):
            raise ConfigError("alike 'furniture' needs one room, scene 'room'")
        if self.alike == "rooms" and self.rooms < 2:
            raise ConfigError("alike 'rooms' needs several rooms")
        if self.rooms > 1 and (self.path != "loop" or self.scene in ("two-rooms", "plane", "turntable")):
            raise ConfigError("several rooms need path 'loop' and scene 'room', 'textureless' or 'repeated'")
        if "blank" in self.hard and self.scene in ("two-rooms", "plane", "turntable"):
            raise ConfigError(f"hard stretch 'blank' needs a room; scene '{self.scene}' has none")
        if len(self.hard) > self.frames / MIN_FRAMES_A_STRETCH:
            least = MIN_FRAMES_A_STRETCH * len(self.hard)
            raise ConfigError(f"{len(self.hard)} hard stretches need at least {least} frames, not {self.frames}")
        for key in ("focal_px", "depth_focal_px"):
            focal = getattr(self, key)
            if focal is not None and not 0.2 < focal / self.width < 20:
                raise ConfigError(f"{key} must be from {0.2 * self.width:g} to {20 * self.width:g}, not {focal}")

    @property
    def camera(self) -> Camera:
        """A Kinect-like camera; unless given, its focal length is scaled to the width of the image."""
        f = self.focal_px or 525.0 * self.width / 640
        centre = ((self.width - 1) / 2, (self.height - 1) / 2)
        return Camera(
            f, f, *centre, self.width, self.height, 5000.0, radial_tangential_lens(*self.distortion), source="simulated"
        )

    @property
    def depth_camera(self) -> DepthCamera | None:
        """The separate depth camera; None if depth has the pixels of the colour camera."""
        if not (self.depth_baseline_m or self.depth_turn_deg or self.depth_focal_px):
            return None
        f = self.depth_focal_px or self.camera.fx
        own = replace(self.camera, fx=f, fy=f, lens=PINHOLE)
        turn = se3.exp_so3(np.radians(self.depth_turn_deg) * TURN_AXIS)
        T_color_depth = se3.pose(turn, np.array([-self.depth_baseline_m, 0.0, 0.0]))
        return DepthCamera(own, tuple(T_color_depth.ravel().tolist()))
