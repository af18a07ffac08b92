"""Hard stretches of a recording: the faults at each of the camera's ticks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from miniloop_cli.geometry import se3
from miniloop_cli.simulation.path import Path
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.typing import Floats

LENGTH_S = {
    "dark": 3.0,
    "blur": 1.5,
    "covered": 1.0,
    "doubled": 1.0,
    "frozen": 0.7,
    "swapped": 0.7,
    "unsorted": 0.7,
    "broken": 0.2,
    "missing": 1.0,
}
NOISE_IN_THE_DARK = 4.0  # times the noise in the light
BLACK = (0.4, 0.6)  # part of a stretch "dark" without any light
SHAKE_RAD, SHAKE_HZ = np.radians([3.0, 5.0]), 2.2  # pitch, yaw
EXPOSED_SHARE = 0.95  # of the time between two frames, in a blurred stretch


@dataclass(frozen=True)
class Stretch:
    """Ticks [first, last) of the camera, counted from 0, with a fault of a `kind`."""

    kind: str
    first: int
    last: int


@dataclass(frozen=True)
class Tick:
    """One tick of the camera and its faults."""

    number: int  # its stamp is number / rate
    source: int  # the tick of its images
    stretches: tuple[str, ...] = ()
    gain: float = 1.0  # of the light
    noise: float = 1.0  # times the noise of the colour image
    covered: bool = False  # the lens: no light and no depth
    blur_s: float = 0.0


def plan(settings: SimulationSettings) -> list[Stretch]:
    """The stretches of `settings.hard` in their order, each in the middle of its share of the recording.

    They last LENGTH_S, or half of their share in short recordings. `blank` is not among them, as it is a place.
    """
    kinds = [kind for kind in settings.hard if kind != "blank"]
    found = []
    for k, kind in enumerate(kinds):
        share = settings.frames / len(kinds)
        length = max(round(min(LENGTH_S[kind] * settings.rate_hz, share / 2)), 1)
        first = round((k + 0.5) * share - length / 2)
        found.append(Stretch(kind, first, first + length))
    return found


def ticks(settings: SimulationSettings) -> list[Tick]:
    """All ticks with recorded frames, in the order of their stamps."""
    found: list[Tick | None] = [Tick(k, k, blur_s=settings.blur_s) for k in range(settings.frames)]
    for stretch in plan(settings):
        for k in range(stretch.first, stretch.last):
            tick = found[k]
            found[k] = None if stretch.kind == "missing" or tick is None else _within(stretch, tick, settings)
    return [tick for tick in found if tick is not None]


def missing(settings: SimulationSettings) -> list[int]:
    """Ticks without a recorded frame."""
    return [k for s in plan(settings) if s.kind == "missing" for k in range(s.first, s.last)]


def _within(stretch: Stretch, tick: Tick, settings: SimulationSettings) -> Tick:
    since = tick.number - stretch.first
    tick = replace(tick, stretches=(stretch.kind,))
    match stretch.kind:
        case "dark":
            u = (since + 0.5) / (stretch.last - stretch.first)
            away = np.clip(abs(u - 0.5) - (BLACK[1] - 0.5), 0, None) / BLACK[0]  # 1 at the ends, 0 where it is black
            gain = float(0.5 - 0.5 * np.cos(np.pi * away))
            black = BLACK[0] <= u <= BLACK[1]
            noise = 1 + (NOISE_IN_THE_DARK - 1) * (1 - gain)
            return replace(tick, gain=gain, noise=noise, stretches=("black",) if black else ("dark",))
        case "blur":
            return replace(tick, blur_s=max(settings.blur_s, EXPOSED_SHARE / settings.rate_hz))
        case "covered":
            return replace(tick, covered=True)
        case "doubled":
            return replace(tick, source=tick.number - since % 2)
        case "frozen":
            return replace(tick, source=stretch.first)
        case "swapped":
            other = tick.number + (1 if since % 2 == 0 else -1)
            return replace(tick, source=other if other < stretch.last else tick.number)
        case _:  # unsorted, broken: applied when the files are written
            return tick


def shaken(path: Path, settings: SimulationSettings) -> Path:
    """The path with shaking in blurred stretches."""
    spans = [(s.first / settings.rate_hz, s.last / settings.rate_hz) for s in plan(settings) if s.kind == "blur"]

    def poses(t: Floats) -> Floats:
        T = path(t)
        for begin, end in spans:
            u = ((np.asarray(t, float) - begin) / (end - begin)).clip(0, 1)
            swing = np.sin(np.pi * u) ** 2 * np.sin(2 * np.pi * SHAKE_HZ * (end - begin) * u)
            turn = np.stack([SHAKE_RAD[0] * swing, SHAKE_RAD[1] * swing, 0 * swing], -1)
            T = se3.pose(T[..., :3, :3] @ se3.exp_so3(turn), T[..., :3, 3])
        return T

    return poses if spans else path
