"""Pairs of colour and depth images: by time if both streams have times, else by frame number, else refused."""

from __future__ import annotations

from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.association import MAX_DIFFERENCE_S, associate
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.stamps import SECONDS, UNITS, Unit, apart, in_seconds, unit_notes, unit_of
from miniloop_cli.datasets.stream import RATE_HZ, Stream
from miniloop_cli.errors import InputError
from miniloop_cli.scene.no_depth import NoDepth
from miniloop_cli.scene.sequence import ColorOnly, Frame, Note, NoteKind, dropped_images
from miniloop_cli.typing import Floats, Ints

PART_GAP_S = 10.0  # between parts of a clock that restarts, so that no motion is interpolated across


@dataclass(frozen=True)
class Paired:
    """Frames sorted by time, notes, and the numbers of colour and depth images.

    color_only: colour images without a partner, if both streams have their own stamps.
    """

    frames: tuple[Frame, ...]
    notes: tuple[Note, ...]
    available: tuple[int, int]
    color_only: ColorOnly | None = None


def pair(root: Path, color: Stream, depth: Stream, together: bool = True, rate_hz: float = RATE_HZ) -> Paired:
    """The frames of two streams of images.

    `together`: both streams count the same frames, so that equal numbers mean equal frames even if images are missing.
    Without times, the stamp is frame number / `rate_hz` s. Raises InputError if it is not known which images belong
    together, and if none do.
    """
    for stream in (color, depth):
        if not stream.sources:
            raise InputError(f"{shown(root)}: {stream.where} names no images")
    notes = (*color.notes, *depth.notes)
    color, depth = _by_times_if_numbers_fail(color, depth)
    if color.times is not None and depth.times is not None:
        rows, color_s, depth_s, said = _by_time(root, color, depth)
    elif color.numbers is not None and depth.numbers is not None:
        if not together:
            _require_common_count(root, color, depth)
        rows, color_s, said = _by_number(root, color, depth, rate_hz)
        depth_s = None
    else:
        named, other = (color, depth) if color.times is not None else (depth, color)
        raise InputError(
            f"{shown(root)}: {named.where} is named by times, {other.where} by numbers: it is not known which belong "
            "together; name both alike, or write tables rgb.txt and depth.txt (timestamp filename)"
        )
    frames = tuple(
        Frame(
            float(color_s[i]),
            color.sources[i],
            depth.sources[j],
            depth_timestamp_s=None if depth_s is None else float(depth_s[j]),
        )
        for i, j in rows.tolist()
    )
    found = Paired(frames, (*notes, *said), (len(color.sources), len(depth.sources)))
    return found if depth_s is None else replace(found, color_only=_color_only(color, color_s, depth, rows, said))


def _color_only(color: Stream, color_s: Floats, depth: Stream, rows: Ints, said: list[Note]) -> ColorOnly | None:
    """The colour images in no pair (m, 2); None if there are none. One image is used for each stamp."""
    paired = np.zeros(len(color_s), bool)
    paired[rows[:, 0]] = True
    order = np.lexsort((np.arange(len(color_s)), ~paired))
    _, first = np.unique(np.round(color_s[order], 6), return_index=True)
    single = np.setdiff1d(order[first], rows[:, 0]).tolist()
    if not single:
        return None
    frames = tuple(Frame(float(color_s[i]), color.sources[i], NoDepth(color.sources[i])) for i in single)
    within = f"within {1000 * MAX_DIFFERENCE_S:.0f} ms"
    text = f"{len(single)} colour images have no depth image {within}: their poses come from tracked points alone"
    notes = [Note(NoteKind.PAIRED, text)]
    twice, left, total = len(color_s) - len(rows) - len(single), len(depth.sources) - len(rows), len(color_s)
    total += len(depth.sources)
    if twice:
        notes.append(dropped_images(f"{twice} colour images repeat a stamp", twice, total))
    if left:
        text = f"{left} of {len(depth.sources)} depth images have no colour image {within}"
        notes.append(dropped_images(text, left, total))
    return ColorOnly(frames, said[-1], tuple(notes))


def pair_rows(root: Path, color: Stream, depth: Stream) -> Paired:
    """Frames of a table that names both images in each row. Raises InputError if its stamps are not times."""
    if not color.sources or len(color.sources) != len(depth.sources):
        raise InputError(f"{shown(root)}: {color.where} does not name as many depth images as colour images")
    unit = _common_unit(root, color, depth)
    assert color.times is not None and depth.times is not None
    shift = _shifts([color.times / unit.per_s], [color.starts()])
    color_s, depth_s = in_seconds(color.times, unit) + shift[0], in_seconds(depth.times, unit) + shift[0]
    frames = [
        Frame(float(t), c, d, depth_timestamp_s=float(u))
        for t, c, u, d in zip(color_s, color.sources, depth_s, depth.sources, strict=True)
    ]
    text = f"{len(frames)} pairs are read from {color.where}; differences of their stamps are ignored"
    notes = (*color.notes, *depth.notes, Note(NoteKind.PAIRED, text), *unit_notes(color.where, color.times, unit))
    frames.sort(key=lambda frame: frame.timestamp_s)
    return Paired(tuple(frames), (*notes, *_start_notes(color)), (len(frames), len(frames)))


def _by_times_if_numbers_fail(color: Stream, depth: Stream) -> tuple[Stream, Stream]:
    """The streams, with numbers read as times if few are equal in both and their intervals are those of times."""
    if color.numbers is None or depth.numbers is None or color.times is not None or depth.times is not None:
        return color, depth
    common = len(np.intersect1d(color.numbers, depth.numbers))
    units = [unit_of(color.numbers), unit_of(depth.numbers)]
    if units[0] != units[1] or units[0] not in UNITS[1:]:
        return color, depth
    if 2 * common > min(len(color.numbers), len(depth.numbers)):
        return color, depth
    return (
        replace(color, numbers=None, times=color.numbers.astype(float), unit=units[0]),
        replace(depth, numbers=None, times=depth.numbers.astype(float), unit=units[0]),
    )


def _by_time(root: Path, color: Stream, depth: Stream) -> tuple[Ints, Floats, Floats, list[Note]]:
    """Pairs (m, 2) by the nearest times, all times (s), and notes."""
    assert color.times is not None and depth.times is not None
    unit = _common_unit(root, color, depth)
    starts = [color.starts(), depth.starts()]
    if len(starts[0]) != len(starts[1]):
        more, fewer = (color, depth) if len(starts[0]) > len(starts[1]) else (depth, color)
        raise InputError(
            f"{more.places[more.starts()[1]]}: the clock restarts here, but not as often in {fewer.where}; split "
            "the recording there"
        )
    times = [in_seconds(color.times, unit), in_seconds(depth.times, unit)]
    shifts = _shifts(times, starts)
    color_s, depth_s = times[0] + shifts[0], times[1] + shifts[1]
    orders = [np.argsort(stamps, kind="stable") for stamps in (color_s, depth_s)]
    found = associate(color_s[orders[0]], depth_s[orders[1]])
    if not len(found):
        raise InputError(f"{shown(root)}: {_why_nothing(color_s, depth_s, color.where, depth.where)}")
    notes = [*unit_notes(color.where, color.times, unit), *_start_notes(color)]
    notes += _without_partner(len(found), len(color_s), len(depth_s), f"within {1000 * MAX_DIFFERENCE_S:.0f} ms")
    return np.stack([orders[0][found[:, 0]], orders[1][found[:, 1]]], axis=1), color_s, depth_s, notes


def _by_number(root: Path, color: Stream, depth: Stream, rate_hz: float) -> tuple[Ints, Floats, list[Note]]:
    """Pairs (m, 2) by equal numbers, the times (s) of all colour images, and notes."""
    assert color.numbers is not None and depth.numbers is not None
    _, i, j = np.intersect1d(color.numbers, depth.numbers, assume_unique=True, return_indices=True)
    if not len(i):
        counts = f"({len(color.numbers)}) and depth ({len(depth.numbers)})"
        raise InputError(f"{shown(root)}: no frame number with both colour {counts}")
    notes, color_s = [], color.numbers / rate_hz
    if color.times is not None and color.unit is not None and (np.diff(color.times) > 0).all():
        color_s = in_seconds(color.times, color.unit)
    else:
        text = f"the frames have no time stamps: {rate_hz:g} frames a second are assumed"
        notes.append(Note(NoteKind.ASSUMED, text))
    notes += _without_partner(len(i), len(color.numbers), len(depth.numbers), "by their numbers")
    return np.stack([i, j], axis=1), color_s, notes


def _without_partner(pairs: int, color: int, depth: int, how: str) -> list[Note]:
    """A note on images without a partner."""
    if pairs == max(color, depth):
        return []
    text = f"{pairs} pairs from {color} colour and {depth} depth images, {how}; the others have no partner"
    return [dropped_images(text, color + depth - 2 * pairs, color + depth)]


def _require_common_count(root: Path, color: Stream, depth: Stream) -> None:
    """Raise InputError if both streams are numbered without gaps from about the same number, but differ in length.

    Each may then count its own images, and a lost image would shift all that follow.
    """
    a, b = color.numbers, depth.numbers
    if a is None or b is None or np.array_equal(a, b):
        return
    gapless = all(numbers[-1] - numbers[0] + 1 == len(numbers) for numbers in (a, b))
    if gapless and abs(a[0] - b[0]) <= 1:
        raise InputError(
            f"{shown(root)}: {color.where} has {len(a)} images from {a[0]} to {a[-1]} and {depth.where} {len(b)} from "
            f"{b[0]} to {b[-1]}, both without gaps: the numbers do not say which belong together; name the images by "
            "their times, write tables rgb.txt and depth.txt (timestamp filename), or, if one only began later or "
            "ended earlier, remove the surplus of the other"
        )


def _common_unit(root: Path, color: Stream, depth: Stream) -> Unit:
    """The unit of two streams of one recording. Raises InputError if they differ or the unit is unknown."""
    assert color.times is not None and depth.times is not None
    lone = [len(s.sources) < 2 and s.unit == SECONDS for s in (color, depth)]
    units = {s.unit for s, alone in zip((color, depth), lone, strict=True) if s.unit is not None and not alone}
    if not units and all(lone):
        return SECONDS
    if not units:
        raise InputError(
            f"{color.places[0]}: the stamps are {apart(color.times):g} apart: seconds, milliseconds or numbers of "
            "frames? Write them in seconds, with decimals, and so that frames are less than 8 s apart"
        )
    if len(units) > 1:
        raise InputError(
            f"{shown(root)}: {color.where} is in {_named(color.unit)}, {depth.where} in {_named(depth.unit)}, by the "
            "intervals of their stamps; write both in seconds"
        )
    return units.pop()


def _named(unit: Unit | None) -> str:
    return unit.name if unit else "an unknown unit"


def _start_notes(color: Stream) -> list[Note]:
    """Notes on clocks that restart."""
    starts = color.starts()
    if len(starts) < 2:
        return []
    some = ", ".join(color.places[k] for k in starts[1:4].tolist())
    text = (
        f"the clock restarts at {some}: the stamps from there on are shifted to begin {PART_GAP_S:g} s after the part "
        "before"
    )
    return [Note(NoteKind.ASSUMED, text)]


def _shifts(times: Many[Floats], starts: Many[Ints]) -> list[Floats]:
    """Offsets (s) to the times of each stream, so that every part of the clock follows the one before it."""
    shifts = [np.zeros(len(stream)) for stream in times]
    bounds = [[*first.tolist(), len(stream)] for stream, first in zip(times, starts, strict=True)]
    for part in range(1, len(starts[0])):
        before = [slice(b[part - 1], b[part]) for b in bounds]
        now = [slice(b[part], b[part + 1]) for b in bounds]
        end = max(float((t[s] + x[s]).max()) for t, s, x in zip(times, before, shifts, strict=True))
        start = min(float(t[s].min()) for t, s in zip(times, now, strict=True))
        for shift, s in zip(shifts, now, strict=True):
            shift[s] = end + PART_GAP_S - start
    return shifts


def _why_nothing(color_s: Floats, depth_s: Floats, color_from: str, depth_from: str) -> str:
    nearest = min(float(np.abs(depth_s - t).min()) for t in color_s)
    return (
        f"no colour image has a depth image within {1000 * MAX_DIFFERENCE_S:.0f} ms; the nearest stamps of "
        f"{color_from} and {depth_from} are {nearest:.3f} s apart; are both of one recording, and in one unit?"
    )
