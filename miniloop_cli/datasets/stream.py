"""The colour or depth images of a recording: sources in order, with times or numbers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from miniloop_cli.datasets.file_names import Keys, keys_of
from miniloop_cli.datasets.images import ImageFile
from miniloop_cli.datasets.paths import list_files, shown
from miniloop_cli.datasets.stamps import SECONDS, Unit, clock_starts, in_seconds
from miniloop_cli.errors import InputError
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import Note, NoteKind
from miniloop_cli.typing import Floats, Ints

RATE_HZ = 30.0  # the nominal rate that turns frame numbers into seconds


@dataclass(frozen=True)
class Stream:
    """Images in the order of recording, with their times or numbers.

    `where` names the table or folder, `places` the row or file of each image, for messages. Times are in `unit`,
    None if this stream alone does not determine it.
    """

    where: str
    sources: tuple[ImageSource, ...]
    places: tuple[str, ...]
    numbers: Ints | None = None
    times: Floats | None = None
    unit: Unit | None = SECONDS
    notes: tuple[Note, ...] = ()

    def starts(self) -> Ints:
        """Rows (k,) at which the clock restarts, by the order of a table, or by a counter beside the times."""
        ordered = self.times is not None and (self.numbers is not None or not self.where.endswith("/"))
        return clock_starts(self.times) if ordered and self.times is not None else np.zeros(1, np.int64)


def seconds_of(numbers: Ints | None, times: Floats | None, unit: Unit | None, rate_hz: float = RATE_HZ) -> Floats:
    """Times (n,) in seconds; without times, numbers (n,) at `rate_hz` frames a second."""
    if times is not None and unit is not None:
        return in_seconds(times, unit)
    assert numbers is not None
    return numbers / rate_hz


def named_stream(root: Path, folder: str, suffixes: tuple[str, ...], unit: Unit | None = None) -> Stream:
    """The images of a sub-folder, ordered by the differing parts of their names; `unit` as in `keys_of`.

    Raises InputError that names the files found if none can be used.
    """
    paths, keys, notes = named_files(root, folder, suffixes, unit)
    where = shown(root.name if folder == "." else folder)
    places = tuple(f"{where}/{shown(path.name)}" for path in paths)
    sources = tuple(ImageFile(path) for path in paths)
    return Stream(f"{where}/", sources, places, keys.numbers, keys.times, keys.unit, notes)


def stamped_files(
    root: Path, folder: str, suffixes: tuple[str, ...], unit: Unit | None = None, rate_hz: float = RATE_HZ
) -> dict[float, Path]:
    """Files named like the images, such as one pose a frame, by the stamps (s) that `pair` gives the images."""
    paths, keys, _ = named_files(root, folder, suffixes, unit)
    return dict(zip(seconds_of(keys.numbers, keys.times, keys.unit, rate_hz).tolist(), paths, strict=True))


def named_files(
    root: Path, folder: str, suffixes: tuple[str, ...], unit: Unit | None = None
) -> tuple[tuple[Path, ...], Keys, tuple[Note, ...]]:
    """Files of a sub-folder in the order of their numbers, else of their times; these keys; and notes on unused files.

    Raises InputError that names the files found if none can be used.
    """
    files, others = list_files(root, folder, suffixes)
    inside = shown(root / folder)
    if not files:
        kinds = ", ".join(suffixes)
        raise InputError(
            f"{inside} has {len(others)} files, none usable: {shown(others[0].name)} is none of {kinds}"
            if others
            else f"{inside} is empty; it should hold {kinds}"
        )
    try:
        keys = keys_of([_stem(path.name, suffixes) for path in files], unit, [shown(path.name) for path in files])
    except InputError as error:
        raise InputError(f"{inside} has {len(files)} files, none usable: {error}") from None
    notes = []
    if keys.odd:
        some = ", ".join(files[k].name for k in keys.odd[:3]) + (", ..." if len(keys.odd) > 3 else "")
        text = f"{len(keys.odd)} of {len(files)} files in {shown(folder)}/ are not named like the others and not used"
        notes.append(Note(NoteKind.DROPPED, f"{text}: {shown(some)}"))
    if others and folder != ".":
        text = f"{len(others)} files in {shown(folder)}/ are not used, such as {shown(others[0].name)}: "
        text += "their suffixes are not supported"
        notes.append(Note(NoteKind.UNUSED, text))
    kept = np.setdiff1d(np.arange(len(files)), keys.odd)
    by = keys.numbers if keys.numbers is not None else keys.times
    assert by is not None
    order = np.argsort(by, kind="stable")
    numbers = None if keys.numbers is None else keys.numbers[order]
    times = None if keys.times is None else keys.times[order]
    return tuple(files[k] for k in kept[order]), Keys(numbers, times, keys.unit), tuple(notes)


def _stem(name: str, suffixes: tuple[str, ...]) -> str:
    ending = next(suffix for suffix in sorted(suffixes, key=len, reverse=True) if name.lower().endswith(suffix))
    return name[: -len(ending)]
