"""Camera paths: functions of time that give (n, 4, 4) poses, camera to world (x right, y down, z forward)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from miniloop_cli.geometry import se3
from miniloop_cli.simulation.layout import ROOM_M, SECOND_ROOM_M, TABLE_M
from miniloop_cli.typing import Floats

Path = Callable[[Floats], Floats]  # (n,) seconds from the start to (n, 4, 4)

TURNS = 1.06
CUT_SHARE = 0.2  # of the path, left out at a cut


def look(position_m: Floats, yaw_rad: Floats, pitch_rad: Floats, roll_rad: Floats) -> Floats:
    """(n, 4, 4) poses at positions (n, 3) with angles (n,); yaw_rad about the vertical, pitch_rad > 0 looks up.

    position_m in the world; roll_rad about the optical axis.
    """
    zero, one = np.zeros_like(yaw_rad), np.ones_like(yaw_rad)
    forward = np.stack(
        [np.cos(yaw_rad) * np.cos(pitch_rad), np.sin(yaw_rad) * np.cos(pitch_rad), np.sin(pitch_rad)], -1
    )
    right = np.stack([np.sin(yaw_rad), -np.cos(yaw_rad), zero], -1)
    level = np.stack([right, np.cross(forward, right), forward], -1)
    roll = se3.exp_so3(np.stack([zero, zero, roll_rad * one], -1))
    return se3.pose(level @ roll, position_m)


def waves(rng: Generator, amplitude: float, periods: float, count: int = 3) -> Callable[[Floats], Floats]:
    """A smooth random function of s (n,) in [0, 1]: `count` sines of about `periods` periods and zero mean."""
    frequency = 2 * np.pi * periods * rng.uniform(0.6, 1.4, count)
    phase, size = rng.uniform(0, 2 * np.pi, count), rng.dirichlet(np.ones(count)) * amplitude
    return lambda s: np.sin(np.multiply.outer(s, frequency) + phase) @ size


def make_path(name: str, scene: str, duration_s: float, rng: Generator, share: float = 1.0) -> Path:
    """The path of a name in `settings.PATHS`, or the first `share` of it; in `two-rooms` each room has half of the
    time.
    """
    if scene == "two-rooms":
        halves = [_in_room(name, scene, duration_s / 2 / share, generator) for generator in rng.spawn(2)]

        def both(t: Floats) -> Floats:
            second = t >= duration_s / 2
            T = np.where(second[:, None, None], halves[1](t - duration_s / 2), halves[0](t))
            T[second, :3, 3] += SECOND_ROOM_M
            return T

        return both
    return _in_room(name, scene, duration_s / share, rng)


def _in_room(name: str, scene: str, duration_s: float, rng: Generator) -> Path:
    start = rng.uniform(0, 2 * np.pi)
    sway = [waves(rng, a, 2.0) for a in (0.15, 0.15, 0.15, 0.10, 0.05)]  # x y z (m), pitch, roll (rad)
    drift = [waves(rng, a, 1.0) for a in (0.8, 0.6, 0.25, 2.6)]  # x y z (m), yaw (rad)
    shift = [waves(rng, 0.5, f, 1) for f in (2.0, 1.3, 0.8)]

    def poses(t: Floats) -> Floats:
        s = np.asarray(t, float) / duration_s
        x, y, z, pitch, roll = (wave(s) for wave in sway)
        pitch -= 0.22
        centre, yaw = np.array([0.0, 0.0, 1.3]), start + 2 * np.pi * TURNS * s
        if scene == "turntable":
            ahead = np.stack([np.cos(yaw), np.sin(yaw)], -1)
            position_m = np.concatenate([-0.62 * ahead, np.full((*s.shape, 1), TABLE_M + 0.42)], -1)
            return look(position_m, yaw, np.full_like(s, -0.6), 0 * s)
        if name == "loop":  # looking across the room, for wide views
            offset = np.stack([x - 0.7 * np.cos(yaw), y - 0.5 * np.sin(yaw), z], -1)
        elif name == "random-walk":
            offset, yaw = np.stack([wave(s) for wave in drift[:3]], -1), start + drift[3](s)
        elif name == "xyz":
            offset, yaw = 0.5 * np.stack([wave(s) for wave in shift], -1), 0.12 * np.sin(yaw)
            centre[0] = ROOM_M[0] / 2 - 1.6
        else:  # rotation, still
            offset = np.zeros((*s.shape, 3))
            if name == "still":
                yaw, pitch, roll = (np.full_like(s, v) for v in (start, -0.22, 0.0))
        if scene == "plane":  # close to the wall x = max with little rotation, so that only this wall is visible
            centre[:] = ROOM_M[0] / 2 - 1.1, 0.0, 1.25
            offset, yaw, pitch = offset * [0.35, 0.5, 0.6], 0.12 * np.sin(yaw), pitch + 0.22
        return look(centre + offset, yaw, pitch, roll)

    return poses


def with_cuts(path: Path, cuts: int, duration_s: float) -> Path:
    """The path without some parts, at evenly spread times."""
    at_s = duration_s * np.arange(1, cuts + 1) / (cuts + 1)
    return lambda t: path(np.asarray(t, float) + CUT_SHARE * duration_s * np.searchsorted(at_s, t, "right"))
