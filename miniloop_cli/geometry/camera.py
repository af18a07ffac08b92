"""The camera: a pinhole behind a lens, and the noise of its depth."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from miniloop_cli.geometry.depth_model import EXACT, DepthModel
from miniloop_cli.geometry.lens import PINHOLE, Lens
from miniloop_cli.typing import Floats


@dataclass(frozen=True)
class DepthNoise:
    """Standard deviation of a depth reading: a + b (z - z0)^2 metres (Khoshelham & Elberink 2012; Nguyen 2012)."""

    a_m: float = 0.0012
    b_per_m: float = 0.0019
    z0_m: float = 0.4

    def sigma_m(self, z_m: Floats) -> Floats:
        """Standard deviation (m) at depths z_m (m), any shape."""
        return self.a_m + self.b_per_m * (np.asarray(z_m, float) - self.z0_m) ** 2


class Trust(StrEnum):
    """How well a camera is known."""

    CALIBRATED = "calibrated"  # measured on this camera
    FACTORY = "factory"  # the device states its own numbers
    GUESS = "guess"  # a default of a driver or of a layout


@dataclass(frozen=True)
class Camera:
    """Intrinsics in pixels (pixel centres at integers), the lens, units of stored depth a metre."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    depth_scale: float = 5000.0
    lens: Lens = PINHOLE
    noise: DepthNoise = DepthNoise()
    source: str = "given"
    depth_scale_assumed: bool = False  # no file states it: the default of the layout
    depth_model: DepthModel = EXACT  # corrects readings in metres, on the pixels of this camera
    trust: Trust = Trust.CALIBRATED

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy", "depth_scale"):  # kernels are compiled for floats
            object.__setattr__(self, name, float(getattr(self, name)))

    @property
    def K(self) -> Floats:
        """(3, 3) calibration matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def undistort(self, px: Floats) -> Floats:
        """(n, 2) measured pixels to the (n, 2) pixels that an ideal pinhole camera of the same K would measure."""
        return self.lens.undistort(np.asarray(px, float).reshape(-1, 2), self.K)

    def distort(self, px_ideal: Floats) -> Floats:
        """The inverse of `undistort`: (n, 2) ideal pixels to (n, 2) measured ones; NaN where the lens images none."""
        return self.lens.distort(np.asarray(px_ideal, float).reshape(-1, 2), self.K)

    def lens_fault(self) -> str | None:
        """Why the lens cannot be inverted over the whole image, with the pixel where it fails; None if it can."""
        f, centre = np.array([self.fx, self.fy]), np.array([self.cx, self.cy])
        u, v = np.linspace(0, self.width - 1, 17), np.linspace(0, self.height - 1, 13)
        grid = np.stack(np.meshgrid(u, v), axis=-1)
        px = grid.reshape(-1, 2)
        radii = np.linalg.norm((px - centre) / f, axis=1)
        end, reach = self.lens.limit
        far = radii.argmax()
        if reach <= radii[far]:
            what = "sees 90 degrees off its axis" if self.lens.model == "fisheye" and end == np.pi / 2 else "folds over"
            x, y = np.rint(px[far]).astype(int)
            return (
                f"the {self.lens.model} lens {what} {reach * self.fx:.0f} px from the principal point, within the"
                f" image: pixel ({x}, {y}) is {radii[far] * self.fx:.0f} px away"
            )
        ideal = self.undistort(px)
        along_u, along_v = (np.diff(ideal.reshape(grid.shape), axis=axis) for axis in (1, 0))
        turned = np.zeros(grid.shape[:2], bool)  # a fold turns the grid over
        (ax, ay), (bx, by) = np.moveaxis(along_u[1:], 2, 0), np.moveaxis(along_v[:, 1:], 2, 0)
        turned[1:, 1:] = ~(ax * by - ay * bx > 0)
        astray = turned.ravel() | ~(np.abs(self.distort(ideal) - px).max(axis=1) < 1e-3)
        if astray.any():
            x, y = np.rint(px[astray][0]).astype(int)
            return f"the {self.lens.model} lens folds over at pixel ({x}, {y}), within the image"
        return None

    def backproject(self, px_ideal: Floats, z_m: Floats) -> Floats:
        """(n, 2) undistorted pixels and (n,) depths along the optical axis (m) to (n, 3) points in the camera frame."""
        z = np.asarray(z_m, float)
        return np.stack([(px_ideal[:, 0] - self.cx) / self.fx * z, (px_ideal[:, 1] - self.cy) / self.fy * z, z], axis=1)

    def project(self, p_cam: Floats) -> Floats:
        """(n, 3) points in the camera frame (m, z > 0) to (n, 2) undistorted pixels."""
        return np.stack(
            [self.fx * p_cam[:, 0] / p_cam[:, 2] + self.cx, self.fy * p_cam[:, 1] / p_cam[:, 2] + self.cy], axis=1
        )

    def point_covariance(self, p_cam: Floats, pixel_sigma_px: float = 0.8) -> Floats:
        """(n, 3, 3) covariance (m^2) of (n, 3) back-projected points.

        C = (2 sigma_z)^2 r r^T + (pixel_sigma z / f)^2 diag(1, 1, 0), r = x / z: depth noise acts along the ray,
        localisation noise across it. The factor 2 covers errors that the sensor model omits (interpolation, edges).
        """
        z = p_cam[:, 2]
        ray = p_cam / z[:, None]
        C = (2 * self.noise.sigma_m(z))[:, None, None] ** 2 * ray[:, :, None] * ray[:, None, :]
        C[:, 0, 0] += (pixel_sigma_px * z / self.fx) ** 2
        C[:, 1, 1] += (pixel_sigma_px * z / self.fy) ** 2
        return C
