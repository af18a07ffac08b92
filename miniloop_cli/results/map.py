"""A map, opened to locate images in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from miniloop_cli.config import Settings
from miniloop_cli.datasets.single_images import guessed_camera
from miniloop_cli.errors import InputError
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.mapping.locate import Locator
from miniloop_cli.mapping.location import Location
from miniloop_cli.mapping.query import query_of
from miniloop_cli.results.map_folder import map_settings, read_map
from miniloop_cli.scene.scene_map import SceneMap
from miniloop_cli.scene.timing import Timing
from miniloop_cli.typing import Bytes, Floats32

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Map:
    """The map of a results folder, loaded once for many images."""

    folder: Path
    content: SceneMap
    settings: Settings
    locator: Locator

    @staticmethod
    def open(folder: Path | str) -> Map:
        """The map of a results folder. Raises MapError if there is none, or it is damaged or of another version."""
        folder = Path(folder)
        content = read_map(folder)
        return Map(folder, content, map_settings(folder, content), Locator.of(content))

    @property
    def recordings(self) -> tuple[str, ...]:
        """Names of the recordings."""
        return tuple(part.name for part in self.content.parts)

    def locate(self, color: ArrayLike, depth_m: Floats32 | None = None, camera: Camera | None = None) -> Location:
        """Where an image was taken.

        color (h, w, 3) uint8 RGB; depth_m (h, w) float32 metres on the same pixels, 0 = no reading; without a camera,
        that of a recording of the map with images of this size is used, else one whose focal length is estimated.
        Raises InputError for shapes that do not fit.
        """
        image = np.ascontiguousarray(color, np.uint8)
        if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < 16:
            raise InputError(f"an image must be (h, w, 3) of 8 bits and 16 pixels or more, this is {image.shape}")
        if depth_m is not None and depth_m.shape != image.shape[:2]:
            raise InputError(f"depth is {depth_m.shape}, colour {image.shape[:2]}; depth must be registered")
        if camera is not None and (camera.height, camera.width) != image.shape[:2]:
            size, own = f"{image.shape[1]} x {image.shape[0]}", f"{camera.width} x {camera.height}"
            raise InputError(f"the image is {size}, the camera is for {own}")
        camera = camera or self.camera_for(image.shape)
        if camera:
            return self._located(image, depth_m, camera, False)
        return self.locate_roughly(image, depth_m, guessed_camera(Path(), image.shape[1], image.shape[0]))

    def locate_roughly(self, color: Bytes, depth_m: Floats32 | None, camera: Camera) -> Location:
        """As `locate`, of color (h, w, 3) and depth_m (h, w), with a focal length that is estimated with the pose."""
        return self._located(color, depth_m, camera, True)

    def locate_file(self, path: Path, color: Bytes, depth_m: Floats32 | None, camera: Camera | None) -> Location:
        """As `locate`, for color (h, w, 3) and depth_m (h, w) of a file, whose EXIF may give a focal length."""
        camera = camera or self.camera_for(color.shape)
        if camera:
            return self.locate(color, depth_m, camera)
        return self.locate_roughly(color, depth_m, guessed_camera(path, color.shape[1], color.shape[0]))

    def camera_for(self, shape: Sequence[int]) -> Camera | None:
        """The camera of the first recording whose images are (h, w, ...) large; None if there is none."""
        sizes = (part.camera for part in self.content.parts)
        return next((camera for camera in sizes if (camera.height, camera.width) == tuple(shape[:2])), None)

    def keyframe_name(self, number: int) -> dict[str, str | int]:
        """The recording of a keyframe, and the number of its frame there."""
        which = int(np.searchsorted(self.content.first, number, side="right")) - 1
        part = self.content.parts[which]
        return {"recording": part.name, "frame": int(part.frame[part.keyframe[number - self.content.first[which]]])}

    def _located(self, color: Bytes, depth_m: Floats32 | None, camera: Camera, rough: bool) -> Location:
        timing = next((part.timing for part in self.content.parts if part.camera == camera), Timing())
        features = self.settings.features
        if any(len(part) < len(part.frame) for part in self.content.parts):  # its frames were tracked
            features = features.of_keyframes(color.shape[1], color.shape[0])
        query = query_of(color, depth_m, camera, features, self.settings.depth, rough, timing)
        found = self.locator.locate(query)
        if found.focal_px is None:
            return found
        # The query may be a smaller version of the image.
        return replace(found, focal_px=found.focal_px * color.shape[1] / query.camera.width)
