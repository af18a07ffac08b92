"""A walk through all the rooms of a building and back: look around in each room, then go through the next door."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from miniloop_cli.simulation.layout import Layout
from miniloop_cli.simulation.path import Path, look, waves
from miniloop_cli.typing import Floats

TURN_RAD_S, WALK_M_S = np.radians(25), 0.5  # of a person with a camera
LOOK_AROUND_RAD = 1.5 * np.pi  # least rotation in a room at the first visit
HEIGHT_M, PITCH_RAD = 1.3, -0.22
BACK_M = np.array([0.7, 0.5])  # the camera stands behind the middle of a room, for wide views
SWAY_PERIOD_S, SWAY = 6.0, (0.08, 0.08, 0.1, 0.15, 0.05)  # x y z (m), pitch, roll (rad)
TREMOR_PERIOD_S, TREMOR = 0.6, (0.003, 0.003, 0.005, 0.006, 0.006, 0.006)  # x y z (m), yaw, pitch, roll (rad)


@dataclass(frozen=True)
class Leg:
    """A turn on the spot, or a straight walk, from rest to rest."""

    yaw_rad: tuple[float, float]
    middle_m: tuple[Floats, Floats]  # (2,) the point that the camera stands behind
    seconds: float


def legs(layout: Layout) -> list[Leg]:
    """The walk at a person's pace."""
    walk, found = layout.walk, list[Leg]()
    middle = [layout.centre_m(room)[:2] for room in walk]
    steps = np.diff(middle, axis=0)
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    yaw, entered = float(headings[0]) - 2 * np.pi, set[int]()
    for k, room in enumerate(walk):
        last = k == len(steps)
        bend = 0.0 if last else (headings[k] - yaw + np.pi) % (2 * np.pi) - np.pi
        if room not in entered or last:
            turns = [bend + 2 * np.pi * n for n in (-2, -1, 0, 1, 2)]
            bend = min((turn for turn in turns if abs(turn) > LOOK_AROUND_RAD - 1e-6), key=abs)
        entered.add(room)
        if abs(bend) > 1e-6:
            found.append(Leg((yaw, yaw + bend), (middle[k], middle[k]), abs(bend) / TURN_RAD_S))
        yaw += bend
        if not last:
            found.append(Leg((yaw, yaw), (middle[k], middle[k + 1]), float(np.linalg.norm(steps[k])) / WALK_M_S))
    return found


def duration_s(layout: Layout) -> float:
    """Duration (s) of the walk at a person's pace."""
    return float(sum(leg.seconds for leg in legs(layout)))


def tour(layout: Layout, duration_s: float, rng: Generator) -> Path:
    """The walk in this time, hand-held: the camera sways with the frequency of a hand, at any pace."""
    parts = legs(layout)
    ends = np.cumsum([leg.seconds for leg in parts])
    begins, ends = np.r_[0, ends[:-1]] / ends[-1], ends / ends[-1]
    yaws = np.array([leg.yaw_rad for leg in parts])
    middles = np.array([leg.middle_m for leg in parts])
    sway = [waves(rng, a, duration_s / SWAY_PERIOD_S) for a in SWAY]
    tremor = [waves(rng, a, duration_s / TREMOR_PERIOD_S, 4) for a in TREMOR]

    def poses(t: Floats) -> Floats:
        s = np.asarray(t, float) / duration_s
        leg = np.minimum(np.searchsorted(ends, s, side="right"), len(parts) - 1)
        u = ((s - begins[leg]) / (ends[leg] - begins[leg])).clip(0, 1)
        eased = u**3 * (10 - 15 * u + 6 * u**2)  # neither speed nor acceleration at the ends
        yaw = yaws[leg, 0] + eased * (yaws[leg, 1] - yaws[leg, 0])
        middle = middles[leg, 0] + eased[..., None] * (middles[leg, 1] - middles[leg, 0])
        x, y, z, pitch, roll = (wave(s) for wave in sway)
        dx, dy, dz, dyaw, dpitch, droll = (wave(s) for wave in tremor)
        back = BACK_M * np.stack([np.cos(yaw), np.sin(yaw)], -1)
        position = np.concatenate([middle - back + np.stack([x + dx, y + dy], -1), (HEIGHT_M + z + dz)[..., None]], -1)
        return look(position, yaw + dyaw, PITCH_RAD + pitch + dpitch, roll + droll)

    return poses
