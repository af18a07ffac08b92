"""The pinhole camera with Brown-Conrady distortion, and the noise of its depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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


@dataclass(frozen=True)
class Camera:
    """Intrinsics in pixels (pixel centres at integers), Brown-Conrady distortion, units of stored depth a metre."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    depth_scale: float = 5000.0
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)  # k1 k2 p1 p2 k3, as OpenCV
    noise: DepthNoise = DepthNoise()
    source: str = "given"

    @property
    def K(self) -> Floats:
        """(3, 3) calibration matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def undistort(self, px: Floats) -> Floats:
        """(n, 2) measured pixels to the (n, 2) pixels that an ideal pinhole camera of the same K would measure."""
        px = np.asarray(px, float).reshape(-1, 2)
        if not any(self.distortion) or not len(px):
            return px
        import cv2

        # OpenCV's default of five steps leaves 0.1 px at the corners of a strong lens.
        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
        ideal = cv2.undistortImagePoints(px, self.K, np.array(self.distortion), arg1=until)
        return np.asarray(ideal, float).reshape(-1, 2)

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
        localisation noise across it. The factor 2 covers what the sensor model leaves out (interpolation, edges).
        """
        z = p_cam[:, 2]
        ray = p_cam / z[:, None]
        C = (2 * self.noise.sigma_m(z))[:, None, None] ** 2 * ray[:, :, None] * ray[:, None, :]
        C[:, 0, 0] += (pixel_sigma_px * z / self.fx) ** 2
        C[:, 1, 1] += (pixel_sigma_px * z / self.fy) ** 2
        return C
