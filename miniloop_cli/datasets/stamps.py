"""Time stamps of recordings: their unit, lost digits, and clocks that restart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miniloop_cli.typing import Floats, Ints


class Unit(NamedTuple):
    """A unit of time: stamps divided by `per_s` are seconds."""

    per_s: float
    name: str


SECONDS = Unit(1.0, "seconds")
FRAME_NUMBERS = Unit(30.0, "frame numbers")  # at the nominal rate of these cameras
MICROSECONDS = Unit(1e6, "microseconds")
MILLISECONDS = Unit(1e3, "milliseconds")
UNITS = (SECONDS, MILLISECONDS, MICROSECONDS, Unit(1e9, "nanoseconds"))

# Intervals (s) that a recording has. The units are a factor of 1000 apart, and so are the ends: one unit fits at most.
CAMERA_S = (0.008, 8.0)
SENSOR_S = (0.0004, 0.4)  # motion capture, odometry, accelerometers
LONGEST_S = 3600.0  # between two images of one recording
EPOCH_S = (9.4e8, 2.9e9)  # seconds since 1970 from 1999 to 2061
MIXED_UP = 15.0  # whole numbers from 2 up to here apart: seconds, milliseconds and every n-th frame are all likely

MIN_EQUAL, EQUAL_SHARE = 3, 0.1
MOST_PARTS = 10  # a clock that starts again more often is a table out of order
MIN_JUMP = 3.0  # intervals that a clock jumps back when it starts again; neighbours change places by less


def unit_of(stamps: ArrayLike, usual_s: tuple[float, float] = CAMERA_S, whole: bool = True) -> Unit | None:
    """The unit of (n,) stamps in any order, by their median interval and magnitude; None where it cannot be told.

    `usual_s` is the range in which the interval lies: CAMERA_S for images, SENSOR_S for what is measured faster.
    Times since 1970 are known by their magnitude. Whole numbers one apart count frames, unless they are written with
    decimals (`whole` is False).
    """
    times = np.unique(np.asarray(stamps, float))
    if not len(times):
        return SECONDS
    largest = float(np.abs(times).max())
    if len(times) == 1:
        return _since_1970(largest, 0.0) or SECONDS
    interval = float(np.median(np.diff(times)))
    whole = whole and bool((times == np.floor(times)).all())
    if epoch := _since_1970(largest, interval):
        likely = _usual(interval, usual_s)
        # Days of uptime in milliseconds are as large as seconds since 1970.
        return None if whole and epoch == SECONDS and likely not in (SECONDS, None) else epoch
    if whole and interval < 2 and usual_s == CAMERA_S:
        return FRAME_NUMBERS
    if whole and 2 <= interval < MIXED_UP and usual_s == CAMERA_S:
        return None
    unit = _usual(interval, usual_s) or (SECONDS if interval < usual_s[0] else None)
    if unit == MILLISECONDS and usual_s == CAMERA_S and not whole:
        # Scans that a hand takes now and then are seconds apart, and unevenly.
        even = float((np.abs(np.diff(times) - interval) <= 0.3 * interval).mean()) > 0.7
        return unit if even and interval >= MIXED_UP else None
    return unit


def unit_beside(stamps: ArrayLike, first_s: float, last_s: float) -> Unit | None:
    """The unit in which (n,) stamps lie at the times of a recording from `first_s` to `last_s`; None if none does.

    For files beside the images, which are on the same clock: their own interval need not be known.
    """
    times = np.asarray(stamps, float)
    if not len(times):
        return None
    fitting = [u for u in UNITS if times.min() / u.per_s <= last_s and times.max() / u.per_s >= first_s]
    if len(fitting) < 2:
        return fitting[0] if fitting else None
    spans = [abs(np.log(max(np.ptp(times) / u.per_s, 1e-9) / max(last_s - first_s, 1e-9))) for u in fitting]
    return fitting[int(np.argmin(spans))]


def apart(stamps: ArrayLike) -> float:
    """Median interval of (n,) stamps, in their own unit; 0 for fewer than two."""
    times = np.unique(np.asarray(stamps, float))
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


def lost_digits(stamps: ArrayLike) -> int | None:
    """Index of the first of (n,) stamps of different images that repeats an earlier one, if so many do that digits
    must have been lost; else None."""
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


def _usual(interval: float, usual_s: tuple[float, float]) -> Unit | None:
    return next((unit for unit in UNITS if usual_s[0] <= interval / unit.per_s < usual_s[1]), None)


def _since_1970(largest: float, interval: float) -> Unit | None:
    return next(
        (u for u in UNITS if EPOCH_S[0] <= largest / u.per_s < EPOCH_S[1] and interval / u.per_s < LONGEST_S), None
    )


def in_seconds(stamps: ArrayLike, unit: Unit) -> Floats:
    """(n,) stamps in seconds."""
    return np.asarray(stamps, float) / unit.per_s
