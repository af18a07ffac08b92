"""Depth from a separate depth camera: the readings depend on the relative pose of the two cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from miniloop_cli.geometry import depth_camera_parameters as of_two
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.camera_parameters import NAMES, OF_ONE_CAMERA, OF_PIXELS, CameraParameters
from miniloop_cli.scene.sequence import DepthCamera
from miniloop_cli.typing import Bools, Floats, Ints

# Depths (k,) m or NaN and slopes (k, 2) m/px at pixels (k, 2) of frames (k,), with depth registered to colour.
DepthReader = Callable[[Camera, DepthCamera, Ints, Floats], tuple[Floats, Floats]]


class ReadingChange(NamedTuple):
    """How readings (k,) change with the parameters: by_theta (len(NAMES), k), evaluated at `theta`."""

    theta: Floats
    by_theta: Floats

    def step(self, theta: Floats) -> Floats:
        """(k,) m, to first order."""
        return np.asarray((theta - self.theta) @ self.by_theta, float)

    def subset(self, rows: Ints | Bools | slice) -> ReadingChange:
        """Those of the rows (indices, a mask or a range)."""
        return ReadingChange(self.theta, self.by_theta[:, rows])


@dataclass(frozen=True)
class TwoCameras:
    """A roughly known depth camera, and a function that gives its readings."""

    given: DepthCamera
    read_depth: DepthReader
    free: tuple[str, ...] = ()  # parameters that an earlier fit estimated: the model is no question any more

    def at(self, parameters: CameraParameters) -> DepthCamera:
        """The depth camera with the steps taken."""
        return self.given.moved(parameters.of_depth_camera)

    def readings(self, parameters: CameraParameters, frame: Ints, px: Floats) -> tuple[Floats, Floats, ReadingChange]:
        """Depths (k,) m or NaN, slopes (k, 2) m/px at measured pixels (k, 2) of frames (k,), and how they depend."""
        own, color = self.at(parameters), parameters.camera
        z_m, slope = self.read_depth(color, own, frame, px)
        X = color.backproject(color.undistort(px), np.where(np.isfinite(z_m), z_m, 1.0))
        by_theta = np.zeros((len(NAMES), len(px)))
        # A step of the colour camera shifts the surface in its image, so that another part of the surface is read.
        by_theta[:OF_PIXELS] = -np.einsum("ki,ijk->jk", slope, parameters.project(X.T).by_parameters)
        by_theta[OF_ONE_CAMERA:] = of_two.reading_slopes(X, slope, color, own.camera, own.T_color_depth)
        return z_m, slope, ReadingChange(parameters.theta, np.where(np.isfinite(z_m), by_theta, 0.0))
