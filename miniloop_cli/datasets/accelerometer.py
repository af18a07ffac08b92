"""Accelerometer tables (`timestamp ax ay az`, as TUM ships them) and the vertical that they give each frame."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.association import parse_stamp
from miniloop_cli.datasets.paths import read_lines, shown
from miniloop_cli.errors import InputError
from miniloop_cli.typing import Floats

WINDOW_S = 0.15  # standard deviation of the low pass: the hand's own accelerations nearly average out
NEAREST_S = 0.1  # a frame farther from any reading has no vertical


def read_accelerometer(path: Path | str) -> tuple[Floats, Floats]:
    """Stamps (n,) seconds, ascending, and readings (n, 3) in the file's unit; further columns are ignored.

    Raises InputError naming file and line for anything that is not four finite numbers, and for a file without rows.
    """
    path = Path(path)
    rows: dict[float, tuple[float, ...]] = {}
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
        rows.setdefault(stamp, values)
    if not rows:
        raise InputError(f"{shown(path)} has no readings; expected lines 'timestamp ax ay az'")
    stamps = np.array(sorted(rows))
    return stamps, np.array([rows[stamp] for stamp in stamps])


def verticals(stamps_s: Floats, readings: Floats, at_s: Floats) -> Floats:
    """Unit vectors (m, 3) along the mean reading around times `at_s` (m,); NaN where there is no reading near.

    The mean is weighted by a Gaussian in time of WINDOW_S.
    """
    found = np.full((len(at_s), 3), np.nan)
    first, last = (np.searchsorted(stamps_s, at_s + sign * 3 * WINDOW_S) for sign in (-1, 1))
    for k, t in enumerate(at_s):
        near = stamps_s[first[k] : last[k]] - t
        if not len(near) or np.abs(near).min() > NEAREST_S:
            continue
        mean = np.exp(-0.5 * (near / WINDOW_S) ** 2) @ readings[first[k] : last[k]]
        length = np.linalg.norm(mean)
        if length > 0:
            found[k] = mean / length
    return found
