"""Motions that are known in some directions only, as before a bare wall, and how open the others are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from miniloop_cli.typing import Bools, Floats

MAX_SIGMA_RAD, MAX_SIGMA_M = 0.015, 0.02  # a less certain direction is open, by one measurement
BELIEVED = np.array([MAX_SIGMA_RAD] * 3 + [MAX_SIGMA_M] * 3)
MAX_OPENNESS = 5.0  # of a motion, with all that makes it less certain, such as depth of another time in a fast turn
LEAST = 1e-6  # information of a direction, with BELIEVED as units: less is rounding


class PartialMotion(NamedTuple):
    """T_cam_key (4, 4), points of the key camera in this one; information (6, 6) of (w, v) in [exp(w) | v] T_cam_key,
    zero in open directions."""

    T_cam_key: Floats
    information: Floats


def openness(information: Floats) -> Floats:
    """The largest standard deviation of a direction, in BELIEVED; infinite if nothing tells it.

    information (..., 6, 6) of (w, v) in rad and m.
    """
    least = np.linalg.eigvalsh(BELIEVED[:, None] * information * BELIEVED)[..., 0]
    return np.where(least > LEAST, np.maximum(least, LEAST) ** -0.5, np.inf)


def closed(information: Floats) -> Bools:
    """Whether all directions of information (..., 6, 6) are known."""
    return openness(information) <= MAX_OPENNESS


def without_open(information: Floats, least_share: float) -> Floats:
    """The information (6, 6) without open directions, and those with less than `least_share` of the best one's."""
    value, axes = np.linalg.eigh(BELIEVED[:, None] * information * BELIEVED)
    value[value < max(1.0, least_share * value[-1])] = 0
    return np.asarray((axes * value) @ axes.T / BELIEVED / BELIEVED[:, None])
