"""What to simulate."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import radial_tangential_lens

SCENES = ("room", "two-rooms", "plane", "textureless", "repeated")
PATHS = ("loop", "xyz", "rotation", "still", "random-walk")


@dataclass(frozen=True)
class SimulationSettings:
    """A simulated recording: scene, camera path and sensor.

    Scenes: `room` (furnished, textured), `two-rooms` (half of the frames in each, no overlap), `plane` (one wall
    fills the view), `textureless` (the room without any texture), `repeated` (the same tile on everything).
    Paths: `loop` (a little over one turn, ending where it began), `xyz` (translations before one wall, every pair
    overlaps), `rotation` (no translation), `still`, `random-walk` (smooth and different for every seed).
    """

    frames: int = 30
    width: int = 640
    height: int = 480
    scene: str = "room"
    path: str = "loop"
    noise: bool = True  # depth noise, disparity steps, holes, colour noise
    noise_level: float = 1.0  # times the noise of a Kinect, in depth and in colour
    moving_object: bool = False  # a figure that walks before the camera, over about a third of the image
    masks: bool = False  # also write mask/: the pixels of the moving object
    depth_limit_m: float = 5.0  # no readings beyond
    exposure: float = 1.0  # gain of the image; 3 saturates most of it
    blur_s: float = 0.0  # exposure time: motion during it blurs the colour image
    rolling_shutter_s: float = 0.0  # time between the first and the last row of an image
    rate_hz: float = 10.0
    path_share: float = 1.0  # only the first part of the path is walked, as slowly as that takes
    focal_px: float | None = None  # None: 525 px at a width of 640
    accelerometer: bool = False  # also write accelerometer.txt, at 100 Hz, with noise and bias
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)  # k1 k2 p1 p2 k3

    def __post_init__(self) -> None:
        for key, value, known in (("scene", self.scene, SCENES), ("path", self.path, PATHS)):
            if value not in known:
                near = difflib.get_close_matches(value, known, n=1)
                hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(known)}"
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
        ):
            if not low <= getattr(self, key) <= high:
                raise ConfigError(f"{key} must be from {low:g} to {high:g}, not {getattr(self, key)}")

        if self.focal_px is not None and not 0.2 < self.focal_px / self.width < 20:
            raise ConfigError(f"focal_px must be from {0.2 * self.width:g} to {20 * self.width:g}, not {self.focal_px}")

    @property
    def camera(self) -> Camera:
        """A Kinect-like camera; unless given, its focal length is scaled to the width of the image."""
        f = self.focal_px or 525.0 * self.width / 640
        centre = ((self.width - 1) / 2, (self.height - 1) / 2)
        return Camera(
            f, f, *centre, self.width, self.height, 5000.0, radial_tangential_lens(*self.distortion), source="simulated"
        )
