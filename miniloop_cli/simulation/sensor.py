"""A model of a structured-light camera: noise, disparity steps, holes, ragged edges."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from miniloop_cli.geometry.camera import DepthNoise
from miniloop_cli.simulation.texture import octaves
from miniloop_cli.typing import Bools, Bytes, Floats32

BASELINE_M, FOCAL_PX, STEPS_PER_PX = 0.075, 580.0, 8  # of the Kinect's infrared pair
NEAR_LIMIT_M = 0.4
GRAZING_COSINE = 0.17  # about 80 degrees
JITTER_PX = 0.5
COLOR_SIGMA = 2.5  # grey levels


def measure_depth(
    depth_m: Floats32,
    cosine: Floats32,
    noise: DepthNoise,
    rng: Generator,
) -> Floats32:
    """(h, w) true depth (m, 0 = nothing there) and cosine of incidence to (h, w) measured depth (m, 0 = no reading).

    - Each reading comes from a pixel up to two pixels away (deviation 0.5 px), which makes edges ragged
      (Barron & Malik 2013; Handa et al. 2014); beside an edge most readings are lost.
    - The error has the deviation `noise.sigma_m(z)` in all: a Gaussian part and the step of the disparity,
      z^2 / (8 f b) (Khoshelham & Elberink 2012).
    - No reading at grazing incidence, and in a few blobs where the surface reflects badly.
    """
    h, w = depth_m.shape
    offset = np.round(rng.standard_normal((2, h, w), np.float32) * JITTER_PX).astype(np.int64)
    rows = (np.arange(h)[:, None] + offset[0]).clip(0, h - 1)
    columns = (np.arange(w) + offset[1]).clip(0, w - 1)
    z = depth_m[rows, columns].astype(np.float64)
    safe = np.maximum(z, 0.1)
    step_m = safe**2 / (STEPS_PER_PX * FOCAL_PX * BASELINE_M)
    gaussian_m = np.sqrt(np.maximum(noise.sigma_m(z) ** 2 - step_m**2 / 12, 0))
    noisy = np.maximum(safe + gaussian_m * rng.standard_normal((h, w)), 0.1)
    steps = STEPS_PER_PX * FOCAL_PX * BASELINE_M
    measured = steps / np.maximum(np.round(steps / noisy), 1)

    lost = (z <= 0) | (cosine < GRAZING_COSINE)
    lost |= _beside_edge(depth_m) & (rng.random((h, w)) < 0.7)
    lost |= octaves(h, w, rng, 64, 0.6) > 2.3
    return np.where(lost, 0, measured).astype(np.float32)


def _beside_edge(depth_m: Floats32) -> Bools:
    """Pixels within one pixel of a jump of more than 4 % in depth (surfaces seen at an angle stay below it)."""
    import cv2

    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    return cv2.morphologyEx(depth_m, cv2.MORPH_GRADIENT, cross) > 0.04 * np.maximum(depth_m, 0.1)


def store_depth(depth_m: Floats32, depth_scale: float, limit_m: float) -> NDArray[np.uint16]:
    """(h, w) uint16 in units of 1 / depth_scale m; 0 outside of the range of the sensor."""
    valid = (depth_m > NEAR_LIMIT_M) & (depth_m < limit_m)
    return np.where(valid, np.round(depth_m * depth_scale), 0).clip(0, 65535).astype(np.uint16)


def store_color(light: Floats32, exposure: float, rng: Generator | None, noise_level: float = 1.0) -> Bytes:
    """(h, w, 3) float light to uint8 RGB: lens softness, gain, and noise if `rng` is given."""
    import cv2

    image = exposure * cv2.GaussianBlur(light, (0, 0), 0.5)
    if rng is not None:
        image += np.float32(noise_level * COLOR_SIGMA) * rng.standard_normal(image.shape, np.float32)
    return np.round(image.clip(0, 255)).astype(np.uint8)
