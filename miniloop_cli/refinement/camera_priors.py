"""What is known of a camera before it has seen anything: standard deviations of its parameters, by its source.

The numbers are what cameras of a kind differ by. Of a guess: a focal length by a few per cent, a centre by some pixels,
a lens by anything that lenses are. Depth errs by some millimetres and by a per cent towards corners and ends of its
range (Khoshelham & Elberink, Sensors 2012). Of a calibration that somebody made: what such calibrations repeat to.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.geometry.camera_parameters import NAMES
from miniloop_cli.typing import Floats

# Centres as shares of the image's width. The depth scale is no parameter: see SCALE.
_SIGMAS: dict[Trust, dict[str, float]] = {
    Trust.GUESS: {
        "focal": 0.05, "aspect": 0.005, "cx": 0.025, "cy": 0.025,
        "k1": 0.3, "k2": 1.0, "p1": 0.005, "p2": 0.005, "k3": 1.0,
        "offset_m": 0.01, "bend_per_m": 0.01, "radial": 0.02, "radial_bend_per_m": 0.01,
    },
    Trust.FACTORY: {
        "focal": 0.01, "aspect": 0.002, "cx": 0.008, "cy": 0.008,
        "k1": 0.1, "k2": 0.3, "p1": 0.002, "p2": 0.002, "k3": 0.3,
        "offset_m": 0.005, "bend_per_m": 0.005, "radial": 0.01, "radial_bend_per_m": 0.005,
    },
    Trust.CALIBRATED: {
        "focal": 0.002, "aspect": 0.0005, "cx": 0.0015, "cy": 0.0015,
        "k1": 0.01, "k2": 0.03, "p1": 0.0005, "p2": 0.0005, "k3": 0.03,
        "offset_m": 0.003, "bend_per_m": 0.003, "radial": 0.005, "radial_bend_per_m": 0.003,
    },
}  # fmt: skip
# Of the unit of depth, relative: no recording tells it, so it stays and is as uncertain as before.
SCALE = {Trust.GUESS: 0.02, Trust.FACTORY: 0.005, Trust.CALIBRATED: 0.005}


def prior_sigmas(camera: Camera) -> Floats:
    """Standard deviations (p,) of the parameters NAMES about those of the camera."""
    known = _SIGMAS[camera.trust]
    unit = {"cx": float(camera.width), "cy": float(camera.width)}
    return np.array([known[name] * unit.get(name, 1.0) for name in NAMES])
