"""The unit of a recording's depth values, and those that mean "no reading", from a sample of its frames."""

from __future__ import annotations

from collections.abc import Sequence as Many
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets.known_sensors import stores_millimetres
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.sensor_steps import disparity_step, too_large_by
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Note, NoteKind, Sequence

SAMPLE = 8
METRES, MILLIMETRES = (0.05, 60.0), (80.0, 60_000.0)  # range of the median of stored distances
LARGEST = 65535  # of 16 bits: never a measured depth
MIN_SHARE = 0.01  # of the pixels, for a value that means "no reading"
NEXT = 0.9  # real depth ends below this part of the value,
SPIKE = 50  # or the value has so many times more pixels than any near it
MIN_OTHERS = 0.05  # share of pixels with other depth, as a plain wall is not missing depth
USUAL_M = (0.3, 12.0)  # median depths of recordings
FIVES = 0.99  # of the values are multiples of 5: millimetres that were stored at 5000 units a metre, as TUM's are
Values = NDArray[Any]


def understand_depth(sequence: Sequence) -> Sequence:
    """The sequence with the unit of floating-point depth and the values that mean "no reading", each with a note.

    Images that cannot be read are ignored. Raises InputError if depth is floating-point in an unknown unit.
    """
    sample = sample_depth(sequence)
    if not sample:
        return sequence
    stated = sequence.depth_format.floating  # then the camera's scale is for these values
    if not stated and sum(stored.dtype.kind == "f" for stored in sample) * 2 > len(sample):
        sequence = _floating(sequence, [stored for stored in sample if stored.dtype.kind == "f"])
    sample = [stored for stored in sample if (stored.dtype.kind == "f") == sequence.depth_format.floating]
    form = sequence.depth_format
    values, notes = [], list(sequence.notes)
    for value, share in no_readings(sample, form.no_reading):
        values.append(value)
        text = f"depth {value:g} ({value / sequence.camera.depth_scale:.2f} m) is read as missing depth: "
        text += f"{100 * share:.2g} % of the pixels hold it, and it is far from all other depths"
        notes.append(Note(NoteKind.ASSUMED, text))
    if sequence.camera.depth_scale_assumed and not form.floating:
        notes.append(_scale_note(sequence, sample, (*form.no_reading, *values)))
    form = replace(form, no_reading=(*form.no_reading, *values), no_reading_found=bool(values))
    return replace(sequence, depth_format=form, notes=tuple(notes))


def sample_depth(sequence: Sequence) -> list[Values]:
    """Stored depth of evenly spaced frames, those left out that cannot be read or have several channels."""
    sample = []
    for k in np.unique(np.linspace(0, len(sequence.frames) - 1, SAMPLE).round().astype(int)).tolist():
        try:
            stored = sequence.frames[k].depth.read()
        except InputError:
            continue
        if stored.ndim == 2 and (stored.dtype == np.uint16 or stored.dtype.kind == "f"):
            sample.append(stored)
    return sample


def no_readings(sample: Many[Values], known: tuple[float, ...] = ()) -> list[tuple[float, float]]:
    """Values that mean "no reading" besides 0, and the share of the pixels that hold each.

    The largest value of 16 bits; and the largest and the smallest value of all, if many pixels of most frames have it
    and it is far from the other readings. `known` values are left out.
    """
    found: list[tuple[float, float]] = []
    pixels = sum(stored.size for stored in sample)
    for which in (None, -1, 0):
        readings = [_readings(stored, (*known, *(value for value, _ in found))) for stored in sample]
        value = _odd_value(readings, pixels, which) if which is not None else float(LARGEST)
        held = 0 if value is None else sum(int((r == value).sum()) for r in readings)
        if value is not None and held:
            found.append((value, held / pixels))
    return found


def _odd_value(readings: list[Values], pixels: int, end: int) -> float | None:
    """The smallest (`end` 0) or largest (-1) of all readings if it is far from the others, as a marker is."""
    values, counts = _counted(np.concatenate(readings)) if readings else (np.zeros(0), np.zeros(0))
    if len(values) < 2:
        return None
    value, count = values[end], int(counts[end])
    others = int(counts.sum()) - count
    holding = sum(bool((r == value).any()) for r in readings)
    if count < MIN_SHARE * pixels or others < MIN_OTHERS * pixels or 2 * holding < len(readings):
        return None
    near = values > NEXT * value if end else values < value / NEXT
    near[end] = False
    alone = counts[near].sum() < 0.001 * others
    spike = end and count > SPIKE * counts[near].max(initial=1)
    return float(value) if alone or spike else None


def _counted(readings: Values) -> tuple[Values, Values]:
    """The different values in ascending order, and how often each occurs."""
    if readings.dtype != np.uint16:
        return np.unique(readings, return_counts=True)
    counts = np.bincount(readings)  # several times as fast as sorting them
    return (values := np.flatnonzero(counts)), counts[values]


def _size(stored: Values) -> tuple[int, int]:
    height, width = stored.shape
    return width, height


def _without(stored: Values, out: tuple[float, ...]) -> Values:
    return np.where(np.isin(stored, np.array(out, stored.dtype)), 0, stored) if out else stored


def _readings(stored: Values, out: tuple[float, ...]) -> Values:
    kept = stored[stored > 0] if stored.dtype == np.uint16 else stored[np.isfinite(stored) & (stored > 0)]
    return kept[~np.isin(kept, np.array(out, stored.dtype))] if out else kept


def _floating(sequence: Sequence, sample: list[Values]) -> Sequence:
    """Floating-point depth in metres or millimetres, by its magnitude; the camera's scale is for whole numbers."""
    no_reading = tuple(value for value, _ in no_readings(sample, sequence.depth_format.no_reading))
    readings = np.concatenate([_readings(stored, no_reading) for stored in sample])
    median = float(np.median(readings)) if len(readings) else 1.0
    unit = next(((name, s) for (a, b), name, s in _UNITS if a <= median < b), None)
    if unit is None:
        raise InputError(
            f"{shown(sequence.root)}: depth is floating-point with a median of {median:.3g}, neither metres nor "
            "millimetres; convert it to metres"
        )
    text = f"depth is floating-point, with a median of {median:.3g}: read as {unit[0]}"
    if sequence.camera.depth_scale not in (unit[1], 1.0):
        text += f"; the camera's depth_scale {sequence.camera.depth_scale:g} is for whole numbers and not used"
    return replace(
        sequence,
        camera=replace(sequence.camera, depth_scale=unit[1]),
        depth_format=replace(sequence.depth_format, floating=True),
        notes=(*sequence.notes, Note(NoteKind.ASSUMED, text)),
    )


_UNITS = ((METRES, "metres", 1.0), (MILLIMETRES, "millimetres", 1000.0))


def _scale_note(sequence: Sequence, sample: list[Values], out: tuple[float, ...]) -> Note:
    """The assumed depth scale, and what contradicts it."""
    scale = sequence.camera.depth_scale
    text = f"depth_scale {scale:g} units a metre is assumed, as no file states it"
    readings = np.concatenate([_readings(stored, out) for stored in sample]) if sample else np.zeros(0)
    if not len(readings):
        return Note(NoteKind.ASSUMED, text)
    median = float(np.median(readings))
    other = 1000.0 if scale == 5000 else 5000.0
    unlikely = not USUAL_M[0] <= median / scale < USUAL_M[1]
    fives = float((readings.astype(np.int64) % 5 == 0).mean())
    depths_m = [_without(stored, out).astype(np.float32) / np.float32(scale) for stored in sample]
    against = ""
    factor = too_large_by(*disparity_step(depths_m))
    if factor and USUAL_M[0] <= median / (scale * factor) < USUAL_M[1]:
        against = f"; its steps are those of a Kinect or Xtion at about {scale * factor:.0f} units a metre"
    elif scale == 1000 and fives > FIVES:
        against = f"; all values are multiples of 5, as in depth of TUM's {other:g} units a metre"
    elif scale != 1000 and fives <= FIVES and (told := stores_millimetres(sequence.camera, _size(sample[0]))):
        against = f"; {told}"
    elif unlikely and USUAL_M[0] <= median / other < USUAL_M[1]:
        against = f"; this is unusual for such sensors, at {other:g} units a metre it would be {median / other:.2f} m"
    text += f": the median depth is {median / scale:.2f} m{against}; state it with --camera FILE"
    return Note(NoteKind.CONTRADICTED if against else NoteKind.ASSUMED, text)
