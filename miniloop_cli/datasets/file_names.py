"""Time stamps or frame numbers from the parts that differ between the names of a folder's images."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np

from miniloop_cli.datasets.stamp_text import date_s
from miniloop_cli.datasets.stamps import EPOCH_S, FRAME_NUMBERS, SECONDS, Unit, apart, unit_of
from miniloop_cli.errors import InputError
from miniloop_cli.typing import Floats, Ints

NUMBER = re.compile(r"\d+(?:\.\d+)?")
MOST_DIGITS = 19  # of a counter or a time in nanoseconds
MANY_APART = 1000  # whole numbers this far apart are micro- or nanoseconds


@dataclass(frozen=True)
class Keys:
    """Frame numbers, times in `unit` (None: unknown), or both, in the order of the names.

    `odd` are the indices of names with another pattern than the rest; numbers and times leave them out.
    """

    numbers: Ints | None
    times: Floats | None
    unit: Unit | None
    odd: tuple[int, ...] = ()


def keys_of(names: Many[str], unit: Unit | None = None, files: Many[str] = ()) -> Keys:
    """Numbers and times in names without suffixes; only the parts that differ between names are used.

    `unit` is that of whole numbers, if a layout states it; `files` are the whole names, for messages. Raises InputError
    (reason only) if two names have the same key, or if most names have none.
    """
    if (dated := _dated(names)) is not None:
        return dated
    files = files or names
    patterns = [NUMBER.sub("#", name) for name in names]
    usual, count = Counter(patterns).most_common(1)[0]
    if "#" not in usual:
        raise InputError(f"{files[patterns.index(usual)]} is neither a number nor a time")
    if 2 * count <= len(names) and len(names) > 1:
        other = next(file for file, pattern in zip(files, patterns, strict=True) if pattern != usual)
        raise InputError(f"{files[patterns.index(usual)]} and {other} are not named alike")
    odd = tuple(k for k, pattern in enumerate(patterns) if pattern != usual)
    kept = [name for k, name in enumerate(names) if k not in set(odd)]
    columns = list(zip(*(NUMBER.findall(name) for name in kept), strict=True))
    numbers, times, unit = _choose(columns, [file for k, file in enumerate(files) if k not in set(odd)], unit)
    return Keys(numbers, times, unit, odd)


def _choose(
    columns: list[tuple[str, ...]], names: Many[str], stated: Unit | None
) -> tuple[Ints | None, Floats | None, Unit | None]:
    """The columns that are a counter and a time; each of `columns` holds one number of every name."""
    columns = _with_fractions(columns)
    differing = [column for column in columns if len(set(column)) > 1] or columns[-1:]
    values = [[float(text) for text in column] for column in differing]
    unique = [len(set(column)) == len(column) for column in values]
    if not any(unique):
        fullest = max(values, key=lambda column: len(set(column)))
        again = next(k for k, value in enumerate(fullest) if value in fullest[:k])
        raise InputError(
            f"{names[fullest.index(fullest[again])]} and {names[again]} have the same number; rename them so that one "
            "number, or a time, is different for each frame"
        )
    numbers = times = None
    unit: Unit | None = SECONDS
    for column, number, alone in zip(differing, values, unique, strict=True):
        if not alone:
            continue
        found, is_time = _time_unit(column, number, stated)
        if is_time:
            times, unit = np.array(number), found
        elif max(map(len, column)) < MOST_DIGITS:
            numbers = np.array([int(text) for text in column], np.int64)
    if numbers is None and times is None:
        raise InputError(f"{names[0]} holds a number too large for a frame or a time")
    return numbers, times, unit


def _time_unit(column: tuple[str, ...], values: list[float], stated: Unit | None) -> tuple[Unit | None, bool]:
    """The unit of a column and whether it holds times at all; whole numbers near each other count frames."""
    if stated is not None:
        return stated, True
    written_whole = not any("." in text for text in column)
    unit = unit_of(values, whole=written_whole)
    if not written_whole:
        return unit, True
    since_1970 = unit is not None and EPOCH_S[0] <= max(values) / unit.per_s < EPOCH_S[1]
    return unit, unit != FRAME_NUMBERS and (since_1970 or apart(values) >= MANY_APART)


def _with_fractions(columns: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Seconds since 1970 and the number after them, micro- or nanoseconds, as one time (`1305031102_175304000`)."""
    joined = list(columns)
    for k in range(len(columns) - 1):
        seconds, after = columns[k], columns[k + 1]
        digits = max(map(len, after))
        whole = all(text.isdigit() for text in (*seconds, *after))
        if not whole or not all(EPOCH_S[0] <= float(text) < EPOCH_S[1] for text in seconds) or digits not in (6, 9):
            continue
        counted = np.diff(sorted({int(text) for text in after}))
        if len(counted) and (counted == 1).all():
            continue  # a counter
        joined[k : k + 2] = [tuple(f"{a}.{b.zfill(digits)}" for a, b in zip(seconds, after, strict=True))]
        break
    return joined


def _dated(names: Many[str]) -> Keys | None:
    """Seconds since 1970 (UTC) if most names hold a date with time of day and all of these differ, else None."""
    found = [date_s(name) for name in names]
    odd = tuple(k for k, seconds in enumerate(found) if seconds is None)
    times = [seconds for seconds in found if seconds is not None]
    if 2 * len(times) <= len(names) or len(set(times)) < len(times):
        return None
    steps = np.diff(sorted(times))
    midnight = all(seconds % 86400 < 3600 for seconds in times)
    if midnight and len(steps) and (steps == 1).all():
        return None  # a date and a counter: 20240501_000012
    return Keys(None, np.array(times), SECONDS, odd)
