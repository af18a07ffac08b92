"""From the stamps or the order of the poses in a file to seconds on the clock of the frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from miniloop_cli.datasets.stamps import EPOCH_S, SECONDS, UNITS, Unit, in_seconds, since_1970, units_at, units_beside
from miniloop_cli.datasets.trajectory_formats import PoseFile
from miniloop_cli.errors import InputError
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Floats, Ints

MAX_STAMP_S = 1e12
EQUAL_SHARE = 0.05  # with more repeated stamps, digits are lost
UNSORTED_SHARE = 0.2
LATE = 3.0  # median steps by which a row may be late
SAME_RHYTHM_S = 0.002

# Gives (n,) stamps of the frames by number, by a description of the counter; called only if a file needs them.
Numbered = Callable[[], Mapping[str, Floats]]


def to_trajectory(file: PoseFile, frames_s: Floats | None = None, numbered: Numbered = dict) -> Trajectory:
    """The poses by time, in seconds on the clock of the frames.

    `frames_s`: (m,) sorted stamps of the frames of the poses; the unit of the file's stamps is the one that matches
    them. Without, the unit follows from their magnitude. `numbered`: for files with one pose a frame instead of stamps
    on the clock of the frames.
    Raises InputError if no unit fits or two do, and if the stamps repeat, jump back or are of another clock.
    """
    if file.stamps is None:
        return by_number(file, numbered())
    keep, words = _in_order(file, file.stamps)
    stamps, T = file.stamps[keep], file.T_world_cam[keep]
    unit = _unit_alone(file, stamps)
    if frames_s is not None and len(frames_s):
        if counts_rows(stamps) and file.time_unit is None:
            return _by_counter(file, stamps, T, frames_s, numbered(), words)
        beside = _unit_beside(file, stamps, T, frames_s)
        if beside is None:
            return _shifted(file, stamps, T, frames_s, numbered(), words)
        unit = beside
    stamps_s = in_seconds(stamps, unit)
    if (largest := np.abs(stamps_s).max()) > MAX_STAMP_S:
        raise InputError(f"{file.name}: a stamp of {largest:.3g} s; expected s, ms, us or ns")
    return Trajectory(stamps_s, T, ", ".join((*file.format, f"stamps in {unit.symbol}", *words)))


def counts_rows(stamps: Floats) -> bool:
    """Whether (n,) sorted stamps are 0, 1, 2 ... or 1, 2, 3 ...: numbers of rows or frames, not times."""
    return len(stamps) > 2 and stamps[0] in (0, 1) and bool((np.diff(stamps) == 1).all())


def by_number(file: PoseFile, numbered: Mapping[str, Floats]) -> Trajectory:
    """Poses without stamps, by the frame stamps (n,). Raises InputError if their numbers differ."""
    for name, stamps_s in numbered.items():
        whole = file.numbers is None or np.array_equal(file.numbers, np.arange(len(stamps_s)))
        if whole and len(file.T_world_cam) == len(stamps_s):
            words = f"by frame number ({len(stamps_s)}: {name})"
            return Trajectory(np.asarray(stamps_s, float), file.T_world_cam, ", ".join((*file.format, words)))
    counts = ", ".join(f"{len(stamps_s)} {name}" for name, stamps_s in numbered.items()) or "no frames to count"
    raise InputError(
        f"{file.name}: {file.format[0]} has no time stamps, and its {len(file.T_world_cam)} poses are not one a frame "
        f"({counts}); give 'timestamp tx ty tz qx qy qz qw' instead"
    )


def _by_counter(
    file: PoseFile, stamps: Floats, T: Floats, frames_s: Floats, numbered: Mapping[str, Floats], words: list[str]
) -> Trajectory:
    """Poses whose first column counts: by frame number, or in seconds where the frames are a second apart."""
    for name, stamps_s in numbered.items():
        if len(stamps_s) == len(stamps):
            found = f"first column counts rows, by frame number ({len(stamps)}: {name})"
            return Trajectory(np.asarray(stamps_s, float), T, ", ".join((*file.format, found, *words)))
    if len(frames_s) > 1 and np.isin(frames_s, stamps).mean() > 0.5:
        return Trajectory(stamps, T, ", ".join((*file.format, "stamps in s", *words)))
    counts = ", ".join(f"{len(stamps_s)} {name}" for name, stamps_s in numbered.items()) or f"{len(frames_s)} poses"
    raise InputError(
        f"{file.name}: the first column counts {len(stamps)} rows ({stamps[0]:g}, {stamps[1]:g}, {stamps[2]:g} ...) "
        f"instead of giving times, and there are {counts}; write the frames' time stamps there"
    )


def _in_order(file: PoseFile, stamps: Floats) -> tuple[Ints, list[str]]:
    """Rows in the order of time, the first of equal stamps, and notes. Raises InputError."""
    steps, words = np.diff(stamps), []
    back = steps < 0
    if back.any() and not (steps <= 0).all():
        k = int((back & (-steps > LATE * np.median(np.abs(steps)))).argmax())
        if -steps[k] > LATE * np.median(np.abs(steps)):
            raise InputError(
                f"{file.where(k + 1)}: the stamps start again here ({stamps[k]:.9g}, then {stamps[k + 1]:.9g}); is the "
                "first column the time, and is this one trajectory?"
            )
        if len(steps) >= 10 and back.mean() > UNSORTED_SHARE:
            where = file.where(int(back.argmax()) + 1)
            raise InputError(f"{where}: the first column falls at {back.sum()} of {len(steps)} rows: is it the time?")
    if back.any():
        words.append(f"sorted by time (line {file.lines[int(back.argmax()) + 1]} is earlier than the one before)")
    keep = np.unique(stamps, return_index=True)[1]
    if equal := len(stamps) - len(keep):
        row = int(np.setdiff1d(np.arange(len(stamps)), keep)[0])
        if equal > max(1, EQUAL_SHARE * len(stamps)):
            raise InputError(
                f"{file.where(row)}: the stamp {stamps[row]:.9g} is repeated, as in {equal} of {len(stamps)} rows: "
                "digits are lost; write stamps to the microsecond"
            )
        words.append(f"{equal} of {len(stamps)} rows left out (line {file.lines[row]} repeats a stamp)")
    return keep, words


def _unit_alone(file: PoseFile, stamps: Floats) -> Unit:
    """The unit by the magnitude of times since 1970; smaller stamps are in seconds, as in TUM's files."""
    return file.time_unit or since_1970(stamps) or SECONDS


def _unit_beside(file: PoseFile, stamps: Floats, T: Floats, frames_s: Floats) -> Unit | None:
    """The unit in which the stamps match those of the frames; None if none does. Raises InputError if two do."""
    if file.time_unit:
        fitting = units_at(stamps, frames_s)
        if file.time_unit in fitting or not fitting:
            return file.time_unit if fitting else None
        raise InputError(
            f"{file.name}: the header says {file.time_unit.symbol}, but the stamps match the frames' times if they "
            f"are in {' or '.join(unit.symbol for unit in fitting)}; correct the header"
        )
    units = units_beside(stamps, frames_s, lambda at_s: int(associate(frames_s, Trajectory(at_s, T))[1].sum()))
    if len(units) > 1:
        first, second = units[0].symbol, units[1].symbol
        raise InputError(
            f"{file.name}: stamps from {stamps[0]:.9g} to {stamps[-1]:.9g} may be in {first} or in {second}; say "
            f"so in a header: '# timestamp[{first}] tx ty tz qx qy qz qw'"
        )
    return units[0] if units else None


def _shifted(
    file: PoseFile, stamps: Floats, T: Floats, frames_s: Floats, numbered: Mapping[str, Floats], words: list[str]
) -> Trajectory:
    """Stamps of another clock, shifted if there is one pose a frame at the same intervals. Raises InputError else."""
    for guess in [file.time_unit] if file.time_unit else UNITS:
        for name, stamps_s in numbered.items():
            at_s = in_seconds(stamps, guess)
            shift = np.asarray(stamps_s) - at_s if len(stamps_s) == len(stamps) > 2 else np.zeros(0)
            if len(shift) and np.ptp(shift) < SAME_RHYTHM_S:
                found = (
                    f"stamps in {guess.symbol}, shifted by {shift.mean():.6f} s onto the frames ({len(shift)}: {name})"
                )
                return Trajectory(np.asarray(stamps_s, float), T, ", ".join((*file.format, found, *words)))
    unit = _unit_alone(file, stamps)
    at_s = in_seconds(stamps, unit)
    advice = "is it of this recording?"
    if abs(at_s[0]) < EPOCH_S[0] <= frames_s[0] < EPOCH_S[1]:
        advice += f" Its clock starts at 0: add the frames' clock at that moment (near {frames_s[0]:.6f}) to it"
    elif abs(frames_s[0]) < EPOCH_S[0] <= at_s[0] < EPOCH_S[1]:
        advice += " The frames' clock starts at 0: subtract the time of the first frame"
    raise InputError(
        f"{file.name}: no poses at the times of the frames (stamps {at_s[0]:.3f} to {at_s[-1]:.3f} s against "
        f"{frames_s[0]:.3f} to {frames_s[-1]:.3f} s); {advice}"
    )
