"""Prior standard deviations of the parameters of a camera, by the source of the camera.

They are the differences between cameras of a kind. For a guess: a focal length by a few per cent, a centre by some
pixels, a lens by the range of common lenses. Depth is wrong by some millimetres, and by a per cent towards the corners
and the ends of its range (Khoshelham & Elberink, Sensors 2012). For a calibration: the repeatability of such
calibrations. Both cameras of a device look in the same direction within a degree, some centimetres apart.
"""

from __future__ import annotations

import numpy as np

from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.geometry.camera_parameters import NAMES, OF_ONE_CAMERA
from miniloop_cli.geometry.depth_camera_parameters import NAMES as TWO
from miniloop_cli.typing import Floats

# Centres as shares of the image's width. The depth scale is not a parameter: see SCALE.
_SIGMAS: dict[Trust, dict[str, float]] = {
    Trust.GUESS: {
        "focal": 0.05, "aspect": 0.005, "cx": 0.025, "cy": 0.025,
        "k1": 0.3, "k2": 1.0, "p1": 0.005, "p2": 0.005, "k3": 1.0,
        "offset_m": 0.01, "bend_per_m": 0.01, "radial": 0.02, "radial_bend_per_m": 0.01,
        "depth_focal": 0.05, "depth_cx": 0.02, "depth_cy": 0.02, "turn": 0.02, "shift": 0.03,
    },
    Trust.FACTORY: {
        "focal": 0.01, "aspect": 0.002, "cx": 0.008, "cy": 0.008,
        "k1": 0.1, "k2": 0.3, "p1": 0.002, "p2": 0.002, "k3": 0.3,
        "offset_m": 0.005, "bend_per_m": 0.005, "radial": 0.01, "radial_bend_per_m": 0.005,
        "depth_focal": 0.01, "depth_cx": 0.008, "depth_cy": 0.008, "turn": 0.005, "shift": 0.003,
    },
    Trust.CALIBRATED: {
        "focal": 0.002, "aspect": 0.0005, "cx": 0.0015, "cy": 0.0015,
        "k1": 0.01, "k2": 0.03, "p1": 0.0005, "p2": 0.0005, "k3": 0.03,
        "offset_m": 0.003, "bend_per_m": 0.003, "radial": 0.005, "radial_bend_per_m": 0.003,
        "depth_focal": 0.002, "depth_cx": 0.0015, "depth_cy": 0.0015, "turn": 0.001, "shift": 0.001,
    },
}  # fmt: skip
# Of the unit of depth, relative: a recording does not determine it, so it keeps its value and its uncertainty.
SCALE = {Trust.GUESS: 0.02, Trust.FACTORY: 0.005, Trust.CALIBRATED: 0.005}


def prior_sigmas(camera: Camera, own: Camera | None = None) -> Floats:
    """Standard deviations (p,) of the parameters about those of `camera`; `own`: a separate depth camera."""
    known = [_SIGMAS[camera.trust]] * OF_ONE_CAMERA + [_SIGMAS[(own or camera).trust]] * len(TWO)
    unit = {name: float(camera.width) for name in ("cx", "cy")} | {
        name: float((own or camera).width) for name in ("depth_cx", "depth_cy")
    }
    of = {name: name.split("_")[0] for name in TWO if name.startswith(("turn", "shift"))}
    return np.array([each[of.get(name, name)] * unit.get(name, 1.0) for each, name in zip(known, NAMES, strict=True)])
