"""Accelerometer tables (`timestamp ax ay az`, as TUM ships them) and the vertical that they give each frame."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.paths import read_lines, shown
from miniloop_cli.datasets.stamp_text import parse_stamp
from miniloop_cli.datasets.stamps import SECONDS, in_seconds, unit_notes, units_beside
from miniloop_cli.errors import InputError
from miniloop_cli.scene.interpolation import nearest
from miniloop_cli.scene.priors import Accelerometer
from miniloop_cli.scene.sequence import Note, NoteKind
from miniloop_cli.typing import Bools, Floats

WINDOW_S = 0.15  # standard deviation of the low pass, over which accelerations of the hand nearly average out
NEAREST_S = 0.1  # a frame farther from any reading has no vertical


def read_accelerometer(path: Path | str, frames_s: Floats) -> tuple[Accelerometer, tuple[Note, ...]]:
    """The readings of a table for frames at times (n,) ascending, and notes on its rows and its stamps.

    Readings are in the file's unit; further columns are ignored. The unit of the stamps is that in which they match the
    times of the frames. Raises InputError naming file and line for anything that is not four finite numbers, for a
    file without rows, and if two units match.
    """
    path = Path(path)
    stamps, readings, notes = _rows(path)
    units = units_beside(stamps, frames_s, lambda at_s: int(_near(at_s, frames_s).sum()))
    if len(units) > 1:
        raise InputError(
            f"{shown(path)}: stamps from {stamps[0]:.9g} to {stamps[-1]:.9g} may be in {units[0].name} or in "
            f"{units[1].name}; write them in seconds"
        )
    unit = units[0] if units else SECONDS
    stamps_s = in_seconds(stamps, unit)
    found = Accelerometer(stamps_s, readings, verticals(stamps_s, readings, frames_s), shown(path))
    return found, (*notes, *unit_notes(shown(path.name), stamps, unit))


def _near(stamps_s: Floats, at_s: Floats) -> Bools:
    """(m,) whether there is a reading near each of the times `at_s` (m,)."""
    return np.asarray(np.abs(stamps_s[nearest(stamps_s, at_s)] - at_s) <= NEAREST_S)


def _rows(path: Path) -> tuple[Floats, Floats, list[Note]]:
    """Stamps (n,), ascending, and readings (n, 3), both as they are written; a note on rows that repeat a stamp."""
    rows: dict[float, tuple[float, ...]] = {}
    repeated = []
    for number, line in read_lines(path):
        where = f"{shown(path)}:{number}"
        parts = line.replace(",", " ").split()
        if len(parts) < 4:
            raise InputError(f"{where}: expected 'timestamp ax ay az', found {len(parts)} values")
        stamp = parse_stamp(parts[0], where)
        try:
            values = tuple(float(text) for text in parts[1:4])
        except ValueError:
            raise InputError(f"{where}: not a number in '{shown(line[:80])}'") from None
        if not all(math.isfinite(value) for value in values):
            raise InputError(f"{where}: NaN or infinity in the reading; remove the row")
        if rows.setdefault(stamp, values) is not values:
            repeated.append(where)
    if not rows:
        raise InputError(f"{shown(path)} has no readings; expected lines 'timestamp ax ay az'")
    stamps = np.array(sorted(rows))
    notes = []
    if repeated:
        text = f"{len(repeated)} of {len(rows) + len(repeated)} rows of {shown(path.name)} repeat a stamp"
        notes.append(Note(NoteKind.DROPPED, f"{text} and are not used, the first: {repeated[0]}"))
    return stamps, np.array([rows[stamp] for stamp in stamps]), notes


def verticals(stamps_s: Floats, readings: Floats, at_s: Floats) -> Floats:
    """Unit vectors (m, 3) along the mean reading around times `at_s` (m,); NaN where there is no reading near.

    Readings (k, 3) at `stamps_s` (k,), sorted. The mean is weighted by a Gaussian in time of WINDOW_S.
    """
    found = np.full((len(at_s), 3), np.nan)
    first, last = (np.searchsorted(stamps_s, at_s + sign * 3 * WINDOW_S) for sign in (-1, 1))
    for k in np.flatnonzero(_near(stamps_s, at_s)):
        apart_s = stamps_s[first[k] : last[k]] - at_s[k]
        mean = np.exp(-0.5 * (apart_s / WINDOW_S) ** 2) @ readings[first[k] : last[k]]
        length = np.linalg.norm(mean)
        if length > 0:
            found[k] = mean / length
    return found
