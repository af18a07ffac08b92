"""The parameters of a camera that a calibration may change, as steps from a given camera, and their effect on pixels.

Steps of the focal length are relative: one for both directions (log), one for fy against fx. Distortion is that of
Brown and Conrady with k1 k2 p1 p2 k3; other lenses keep their coefficients. Depth as in depth_model.py; a depth camera
beside the colour camera as in depth_camera_parameters.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from miniloop_cli.geometry import depth_camera_parameters, depth_model
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import radial_tangential_lens
from miniloop_cli.typing import Floats, Ints

INTRINSICS = ("focal", "aspect", "cx", "cy")
DISTORTION = ("k1", "k2", "p1", "p2", "k3")
NAMES = (*INTRINSICS, *DISTORTION, *depth_model.NAMES, *depth_camera_parameters.NAMES)
OF_PIXELS = len(INTRINSICS) + len(DISTORTION)
OF_ONE_CAMERA = OF_PIXELS + len(depth_model.NAMES)
OF_DEPTH = slice(OF_PIXELS, OF_ONE_CAMERA)
FARTHEST = 4.0  # squared radius beyond which the polynomial is not evaluated
_STEP = 1e-5


def numbers(*names: str) -> Ints:
    """Indices (k,) of the named parameters."""
    return np.array([NAMES.index(name) for name in names], np.int64)


@dataclass(frozen=True)
class Projection:
    """Pixels (2, k) of points; derivatives by the points (2, 3, k) and by the parameters (2, OF_PIXELS, k)."""

    px: Floats
    by_point: Floats
    by_parameters: Floats


@dataclass(frozen=True)
class CameraParameters:
    """Steps `theta` (len(NAMES),) from the camera `given`; `middle_m`: the depth that the depth model keeps."""

    given: Camera
    theta: Floats
    middle_m: float

    @classmethod
    def between(cls, given: Camera, camera: Camera, of_depth_camera: Floats, middle_m: float) -> CameraParameters:
        """Steps from one camera to another of the same lens model; `of_depth_camera` (8,): of the depth camera."""
        focal, focal_y = np.log(camera.fx / given.fx), np.log(camera.fy / given.fy)
        before, after = (cls(each, np.zeros(len(NAMES)), middle_m) for each in (given, camera))
        lens = after.distortion - before.distortion if before.bends else np.zeros(len(DISTORTION))
        depth = np.subtract(camera.depth_model.coefficients, given.depth_model.coefficients)
        steps = [focal, focal_y - focal, camera.cx - given.cx, camera.cy - given.cy, *lens, *depth, *of_depth_camera]
        return cls(given, np.array(steps), middle_m)

    @property
    def bends(self) -> bool:
        """Whether the coefficients of the lens are among the parameters."""
        return self.given.lens.ideal or (
            self.given.lens.model == "radial-tangential" and len(self.given.lens.coefficients) == 5
        )

    @property
    def distortion(self) -> Floats:
        """(5,) coefficients k1 k2 p1 p2 k3."""
        start = np.zeros(5) if self.given.lens.ideal else np.array(self.given.lens.coefficients)
        return start + self.theta[4:OF_PIXELS]

    @property
    def focal(self) -> tuple[float, float]:
        """fx, fy in px."""
        f = np.exp(self.theta[0])
        return float(self.given.fx * f), float(self.given.fy * f * np.exp(self.theta[1]))

    @property
    def depth(self) -> depth_model.DepthModel:
        """The depth model: that of the given camera, and the steps."""
        start = np.array(self.given.depth_model.coefficients)
        offset, bend, radial, radial_bend = (start + self.theta[OF_DEPTH]).tolist()
        return depth_model.DepthModel(offset, bend, radial, radial_bend, self.middle_m)

    @property
    def camera(self) -> Camera:
        """The camera with the steps taken."""
        fx, fy = self.focal
        lens = radial_tangential_lens(*self.distortion.tolist()) if self.bends else self.given.lens
        depth = self.depth if self.theta[OF_DEPTH].any() else self.given.depth_model
        cx, cy = self.given.cx + float(self.theta[2]), self.given.cy + float(self.theta[3])
        return replace(self.given, fx=fx, fy=fy, cx=cx, cy=cy, lens=lens, depth_model=depth)

    @property
    def of_depth_camera(self) -> Floats:
        """(8,) steps of the depth camera beside."""
        return self.theta[OF_ONE_CAMERA:]

    def depth_step(self, z_m: Floats, rho: Floats) -> Floats:
        """What the steps add (k,) (m) to readings `z_m` (k,) of the given camera; `rho` (k,) as in depth_model.rho."""
        return np.tensordot(self.theta[OF_DEPTH], depth_model.basis(z_m, rho, self.middle_m)[0], 1)

    def project(self, p_cam: Floats) -> Projection:
        """Measured pixels of points (3, k) m, z > 0. The last axis runs over the points, as in refinement."""
        near = 1 / p_cam[2]
        x, y = p_cam[0] * near, p_cam[1] * near
        (bent_x, bent_y), (xx, xy, yx, yy), by_coefficients = self._bent(x, y)
        fx, fy = self.focal
        px = np.stack([fx * bent_x + self.given.cx + self.theta[2], fy * bent_y + self.given.cy + self.theta[3]])
        by_point = np.empty((2, 3, len(x)))
        for axis, (f, along_x, along_y) in enumerate(((fx, xx, xy), (fy, yx, yy))):
            by_point[axis, 0], by_point[axis, 1] = f * near * along_x, f * near * along_y
            by_point[axis, 2] = -(x * by_point[axis, 0] + y * by_point[axis, 1])
        by_parameters = np.zeros((2, OF_PIXELS, len(x)))
        by_parameters[0, 0], by_parameters[1, 0] = fx * bent_x, fy * bent_y
        by_parameters[1, 1] = fy * bent_y
        by_parameters[0, 2] = by_parameters[1, 3] = 1.0
        if self.bends:
            by_parameters[0, 4:], by_parameters[1, 4:] = fx * by_coefficients[0], fy * by_coefficients[1]
        return Projection(px, by_point, by_parameters)

    def _bent(self, x: Floats, y: Floats) -> tuple[Floats, tuple[Floats, ...], Floats]:
        """Points on the plane z = 1 as the lens images them (2, k), four derivatives, those by k1 k2 p1 p2 k3."""
        if not self.bends:
            return self._bent_by_any_lens(x, y)
        k1, k2, p1, p2, k3 = self.distortion
        s = np.minimum(x * x + y * y, FARTHEST)
        g, g_s = 1 + s * (k1 + s * (k2 + s * k3)), k1 + s * (2 * k2 + 3 * k3 * s)
        bent_x, bent_y = x * g + 2 * p1 * x * y + p2 * (s + 2 * x * x), y * g + p1 * (s + 2 * y * y) + 2 * p2 * x * y
        xx = g + 2 * x * x * g_s + 2 * p1 * y + 6 * p2 * x
        xy = 2 * x * y * g_s + 2 * p1 * x + 2 * p2 * y
        yy = g + 2 * y * y * g_s + 6 * p1 * y + 2 * p2 * x
        by_x = [x * s, x * s**2, 2 * x * y, s + 2 * x * x, x * s**3]
        by_y = [y * s, y * s**2, s + 2 * y * y, 2 * x * y, y * s**3]
        return np.stack([bent_x, bent_y]), (xx, xy, xy, yy), np.stack([by_x, by_y])

    def _bent_by_any_lens(self, x: Floats, y: Floats) -> tuple[Floats, tuple[Floats, ...], Floats]:
        def bent(x: Floats, y: Floats) -> Floats:
            return self.given.lens.distort(np.stack([x, y], axis=1), np.eye(3)).T

        at, by_x, by_y = bent(x, y), bent(x + _STEP, y) - bent(x - _STEP, y), bent(x, y + _STEP) - bent(x, y - _STEP)
        (xx, yx), (xy, yy) = by_x / (2 * _STEP), by_y / (2 * _STEP)
        return at, (xx, xy, yx, yy), np.zeros((2, 5, len(x)))
