"""Time stamps of recordings: their unit, lost digits, and clocks that restart."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.scene.sequence import Note, NoteKind
from miniloop_cli.typing import Floats, Ints


class Unit(NamedTuple):
    """A unit of time: stamps divided by `per_s` are seconds."""

    per_s: float
    name: str
    symbol: str


SECONDS = Unit(1.0, "seconds", "s")
MILLISECONDS = Unit(1e3, "milliseconds", "ms")
MICROSECONDS = Unit(1e6, "microseconds", "us")
UNITS = (SECONDS, MILLISECONDS, MICROSECONDS, Unit(1e9, "nanoseconds", "ns"))
BY_SYMBOL = {unit.symbol: unit for unit in UNITS}
FRAME_NUMBERS = Unit(30.0, "frame numbers", "frames")  # at the nominal rate of these cameras

# Range of intervals (s) between images. Its ratio is 1000, as that of the units, so at most one unit fits.
CAMERA_S = (0.008, 8.0)
BESIDE_S = (0.0005, 10.0)  # of other measurements; the frames' times decide the rest
MARGIN_S = 0.1  # by which a frame may be outside of the times of such a file
CLEARLY = 2.0  # the right unit serves so many times more frames than another
LONGEST_S = 3600.0  # between two images of one recording
EPOCH_S = (9.4e8, 2.9e9)  # seconds since 1970 from 1999 to 2061
MIXED_UP = 15.0  # whole numbers from 2 up to here apart: seconds, milliseconds and every n-th frame are all likely

MIN_EQUAL, EQUAL_SHARE = 3, 0.1
MOST_PARTS = 10  # a table with more restarts is out of order
MIN_JUMP = 3.0  # intervals that a restarting clock jumps back; exchanged neighbours jump by less


def unit_of(stamps: ArrayLike, whole: bool = True) -> Unit | None:
    """The unit of (n,) stamps of images in any order, by their median interval and magnitude; None if in doubt.

    Times since 1970 are recognised by their magnitude. Whole numbers with steps of one count frames, unless they are
    written with decimals (`whole` is False).
    """
    times = np.unique(np.asarray(stamps, float))
    if not len(times):
        return SECONDS
    if len(times) == 1:
        return since_1970(times) or SECONDS
    interval = apart(times)
    whole = whole and bool((times == np.floor(times)).all())
    if epoch := since_1970(times):
        likely = _camera_unit(interval)
        # Days of uptime in milliseconds are as large as seconds since 1970.
        return None if whole and epoch == SECONDS and likely not in (SECONDS, None) else epoch
    if whole and interval < MIXED_UP:
        return FRAME_NUMBERS if interval < 2 else None
    unit = _camera_unit(interval) or (SECONDS if interval < CAMERA_S[0] else None)
    if unit == MILLISECONDS and not whole:
        # Single scans by hand are seconds apart, and uneven.
        even = float((np.abs(np.diff(times) - interval) <= 0.3 * interval).mean()) > 0.7
        return unit if even and interval >= MIXED_UP else None
    return unit


def units_at(stamps: Floats, frames_s: Floats) -> list[Unit]:
    """The units in which (n,) sorted stamps of another file match the times (m,) of some frames."""
    ends_s = [(unit, stamps[0] / unit.per_s - MARGIN_S, stamps[-1] / unit.per_s + MARGIN_S) for unit in UNITS]
    return [unit for unit, first, last in ends_s if ((frames_s >= first) & (frames_s <= last)).any()]


def units_beside(stamps: Floats, frames_s: Floats, served: Callable[[Floats], int]) -> list[Unit]:
    """The possible units of (n,) sorted stamps of another file, the most likely first.

    One if it is clear; none if they match the times `frames_s` (m,) of frames in no unit. `served`: gives the number of
    frames that stamps in seconds serve.
    """
    found, interval = units_at(stamps, frames_s), apart(stamps)
    usual = [u for u in found if len(stamps) < 2 or BESIDE_S[0] <= interval / u.per_s <= BESIDE_S[1]]
    if not usual and SECONDS in found and interval > BESIDE_S[1]:
        return [SECONDS]  # they are far apart
    if len(usual) < 2:
        return usual
    counts = {unit: served(in_seconds(stamps, unit)) for unit in usual}
    first, second, *_ = usual = sorted(usual, key=lambda unit: -counts[unit])
    return usual[:1] if counts[first] and counts[first] >= CLEARLY * counts[second] else usual


def apart(stamps: ArrayLike) -> float:
    """Median interval of (n,) stamps, in their own unit; 0 for fewer than two."""
    times = np.unique(np.asarray(stamps, float))
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


def lost_digits(stamps: ArrayLike) -> int | None:
    """Index of the first of (n,) stamps of different images that repeats an earlier one, if so many do that digits are
    lost; else None."""
    times = np.asarray(stamps, float)
    _, first = np.unique(times, return_index=True)
    repeated = np.setdiff1d(np.arange(len(times)), first)
    return int(repeated[0]) if len(repeated) >= max(MIN_EQUAL, EQUAL_SHARE * len(times)) else None


def clock_starts(stamps: ArrayLike) -> Ints:
    """Indices of (n,) stamps, in the order of recording, at which the clock starts again; the first is always 0.

    A clock was reset if the stamps jump back into a time that was already recorded and are evenly spaced before and
    after the jump. Rows that are merely out of order are not evenly spaced.
    """
    times, none = np.asarray(stamps, float), np.zeros(1, np.int64)
    steps = np.diff(times)
    back = np.flatnonzero(steps < 0) + 1
    if not 1 <= len(back) < MOST_PARTS or not (steps > 0).any():
        return none
    onward = steps[steps > 0]
    usual = float(np.median(onward))
    even = float((np.abs(onward - usual) <= 0.4 * usual).mean()) > 0.7
    starts = np.concatenate([none, back])
    parts = np.split(times, back)
    if not even or min(map(len, parts)) < 2 or (steps[back - 1] > -MIN_JUMP * usual).any():
        return none
    ends = [(part[0], part[-1]) for part in parts]
    mixed = any(a <= d and c <= b for k, (a, b) in enumerate(ends) for c, d in ends[k + 1 :])
    return starts if mixed else none


def _camera_unit(interval: float) -> Unit | None:
    return next((unit for unit in UNITS if CAMERA_S[0] <= interval / unit.per_s < CAMERA_S[1]), None)


def since_1970(stamps: ArrayLike) -> Unit | None:
    """The unit in which (n,) stamps are times since 1970, by their magnitude; None if they are not."""
    largest, interval = float(np.abs(np.asarray(stamps, float)).max()), apart(stamps)
    return next(
        (u for u in UNITS if EPOCH_S[0] <= largest / u.per_s < EPOCH_S[1] and interval / u.per_s < LONGEST_S), None
    )


def in_seconds(stamps: ArrayLike, unit: Unit) -> Floats:
    """(n,) stamps in seconds."""
    return np.asarray(stamps, float) / unit.per_s


def unit_notes(where: str, stamps: Floats, unit: Unit) -> list[Note]:
    """Notes on the unit of (n,) stamps of the table or folder `where`, if it is not seconds."""
    if unit == SECONDS:
        return []
    if unit == FRAME_NUMBERS:
        text = f"the stamps of {where} are frame numbers: {unit.per_s:g} frames a second are assumed"
        return [Note(NoteKind.ASSUMED, text)]
    dated = EPOCH_S[0] <= float(np.abs(stamps).max()) / unit.per_s < EPOCH_S[1]
    text = f"the stamps of {where} are {_plainly(apart(stamps))} apart: read as {unit.name} and converted to seconds"
    return [Note(NoteKind.CONVERTED if dated else NoteKind.ASSUMED, text)]


def _plainly(number: float) -> str:
    """A number without an exponent."""
    return f"{number:.0f}" if number >= 1000 else f"{number:g}"
