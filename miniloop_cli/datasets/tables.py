"""Tables of images with rows `timestamp filename`, or `timestamp filename timestamp filename`."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from miniloop_cli.datasets.images import ImageFile
from miniloop_cli.datasets.paths import list_files, read_lines, shown, within
from miniloop_cli.datasets.stamp_text import parse_stamp
from miniloop_cli.datasets.stamps import clock_starts, lost_digits, unit_of
from miniloop_cli.datasets.stream import Stream
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import Note, NoteKind
from miniloop_cli.typing import Floats

SEPARATOR = r"[\s,;]+"
FIELD = re.compile(r"\"([^\"]*)\"|'([^']*)'|([^\s,;]+)")
STAMP = re.compile(r"[\"']?([^\s,;\"']+)[\"']?" + SEPARATOR + r"(\S.*)")
DECIMAL_COMMA = re.compile(r"^(-?\d+),(\d+)(?=[\s;])")
ABSOLUTE = re.compile(r"/|[A-Za-z]:/")
TITLES = re.compile(r"[\"']?(time|stamp|frame|index|id\b|t\b)", re.IGNORECASE)


@dataclass(frozen=True)
class Row:
    """A row: its file and line, its stamp as written, and the rest."""

    place: str
    stamp: str
    rest: str


def read_table(root: Path, name: str, folders: tuple[str, ...] = ()) -> Stream:
    """The images that a table in `root` names, in the order of its rows.

    File names may be quoted, have backslashes, be bare (they are searched in `folders`) or absolute paths of another
    machine (the longest end that exists is used); further columns are ignored. Raises InputError naming file and line
    for a malformed row, one that points outside `root`, many equal stamps, and if no row names an existing file.
    """
    rows = list(_rows(root / name))
    return _read(root, name, rows, FileFinder(root, folders))


def read_associations(
    root: Path, name: str, color_folders: tuple[str, ...], depth_folders: tuple[str, ...]
) -> tuple[Stream, Stream]:
    """Colour and depth of a table of four columns, row by row; the paths show which pair is depth.

    Raises InputError as `read_table`, and for rows with fewer columns.
    """
    rows = list(_rows(root / name))
    columns = [[a or b or c for a, b, c in FIELD.findall(row.rest)] for row in rows]
    for row, fields in zip(rows, columns, strict=True):
        if len(fields) < 3:
            raise InputError(f"{row.place}: expected 'timestamp filename timestamp filename'")
    first = [Row(row.place, row.stamp, fields[0]) for row, fields in zip(rows, columns, strict=True)]
    second = [Row(row.place, fields[1], fields[2]) for row, fields in zip(rows, columns, strict=True)]
    color, depth = (second, first) if rows and "depth" in columns[0][0].lower() else (first, second)
    images = _read(root, name, color, FileFinder(root, color_folders))
    place = {row.place: k for k, row in enumerate(color)}
    kept = [place[where] for where in images.places]
    return images, _read(root, name, depth, FileFinder(root, depth_folders), kept)


def _rows(path: Path) -> Iterator[Row]:
    first = True
    for number, line in read_lines(path):
        place = f"{shown(path)}:{number}"
        text = DECIMAL_COMMA.sub(r"\1.\2", line)
        match = STAMP.fullmatch(text)
        if first and TITLES.match(line) and not any(map(str.isdigit, line.split()[0])):
            first = False
            continue
        first = False
        if match is None:
            raise InputError(f"{place}: expected 'timestamp filename', found '{shown(line[:40])}'")
        yield Row(place, match[1], match[2])


def _spellings(rest: str) -> Iterator[str]:
    """Possible file names in the rest of a row: a quoted part, all of it, all up to a separator."""
    quoted = re.match(r"\"([^\"]+)\"|'([^']+)'", rest)
    if quoted:
        yield quoted[1] or quoted[2]
        return
    yield rest
    for separator in (r"[,;\t]", r"\s{2,}", r"\s"):
        parts = re.split(separator, rest, maxsplit=1)
        if len(parts) > 1 and parts[0].strip():
            yield parts[0].strip().strip("\"'")


class FileFinder:
    """Finds the files of rows, below one folder."""

    def __init__(self, root: Path, folders: tuple[str, ...]) -> None:
        self.root, self.folders = root, folders
        self.converted = 0  # rows whose file was found under another path
        self.cut = 0  # rows with further columns after the file's name
        self.missing: list[Row] = []

    def find(self, place: str, rest: str) -> Path:
        """The file that the rest of a row names; the path as written if there is none.

        Raises InputError naming `place` for one that points outside.
        """
        written = list(_spellings(rest))
        for name in written:
            for m, candidate in enumerate(self._candidates(name)):
                try:
                    path = within(self.root, candidate, place)
                except InputError:
                    continue
                if path.is_file():
                    self.converted += m > 0
                    self.cut += name not in (rest, rest[1:-1])
                    return path
        self.missing.append(Row(place, "", written[-1]))
        plain = written[-1].replace("\\", "/")
        if ABSOLUTE.match(plain) and not os.path.lexists(plain):  # of another machine: a file in this folder
            plain = f"{self.folders[0]}/{PurePosixPath(plain).name}" if self.folders else PurePosixPath(plain).name
        return within(self.root, plain, place)

    def _candidates(self, name: str) -> Iterator[str]:
        yield name
        plain = name.replace("\\", "/")
        yield plain
        parts = PurePosixPath(plain).parts
        for start in range(1, len(parts)):
            yield "/".join(parts[start:])
        for folder in self.folders if parts else ():
            yield f"{folder}/{parts[-1]}"


def _read(root: Path, name: str, rows: list[Row], files: FileFinder, kept: list[int] | None = None) -> Stream:
    """Rows with their files. Rows that repeat a stamp are left out and noted, unless `kept` gives the rows to keep.

    Raises InputError as `read_table`.
    """
    paths = [files.find(row.place, row.rest) for row in rows]
    values = np.array([parse_stamp(row.stamp, row.place) for row in rows], float)
    notes = _file_notes(root, name, rows, files)
    if kept is None:
        kept = _once(rows, values, paths)
        if left := sorted(set(range(len(rows))) - set(kept)):
            text = f"{len(left)} of {len(rows)} rows of {name} repeat a stamp and are not used"
            notes.append(Note(NoteKind.DROPPED, f"{text}, the first: {rows[left[0]].place}"))
    return Stream(
        name,
        tuple(ImageFile(paths[k]) for k in kept),
        tuple(rows[k].place for k in kept),
        times=values[kept],
        unit=unit_of(values[kept], whole=not any("." in row.stamp for row in rows)),
        notes=tuple(notes),
    )


def _once(rows: list[Row], values: Floats, paths: list[Path]) -> list[int]:
    """The first row of each stamp since the clock started. Raises InputError if too many rows repeat a stamp.

    Rows that repeat stamp and file do not count as repeated stamps.
    """
    first: dict[tuple[float, Path], int] = {}
    for k, key in enumerate(zip(values.tolist(), paths, strict=True)):
        first.setdefault(key, k)
    once, kept = np.array(list(first.values()), np.int64), []
    for part in np.split(once, clock_starts(values[once])[1:]):
        if (again := lost_digits(values[part])) is not None:
            row = rows[part[again]]
            raise InputError(
                f"{row.place}: the stamp {shown(row.stamp)} is repeated, as many are: digits were lost; "
                "write stamps with all their decimals"
            )
        kept += np.sort(part[np.unique(values[part], return_index=True)[1]]).tolist()
    return kept


def _file_notes(root: Path, name: str, rows: list[Row], files: FileFinder) -> list[Note]:
    """Notes on rows whose file is missing, or was found under another path.

    Raises InputError if no row names an existing file, as the table is then wrong.
    """
    notes = []
    if files.missing:
        row = files.missing[0]
        if len(files.missing) >= len(rows):
            raise InputError(
                f"{row.place}: no such file: {shown(row.rest)}; no row of this table names an existing file; "
                f"{_held(root, files)}"
            )
        text = f"{len(files.missing)} of {len(rows)} rows of {name} name a missing file, the first: {row.place}"
        notes.append(Note(NoteKind.DROPPED, f"{text} ({shown(row.rest)})"))
    if files.converted:
        text = f"{files.converted} of {len(rows)} rows of {name} give a path that does not exist here"
        notes.append(Note(NoteKind.CONVERTED, f"{text}; the file was found by the end of the path"))
    if files.cut:
        text = f"{files.cut} of {len(rows)} rows of {name} have further columns, which are not used"
        notes.append(Note(NoteKind.UNUSED, text))
    return notes


def _held(root: Path, files: FileFinder) -> str:
    """The content of the searched folders, for a message."""
    for folder in files.folders:
        if (root / folder).is_dir():
            found, _ = list_files(root, folder, ("",))
            return f"{folder}/ holds {len(found)} files" + (f", such as {shown(found[0].name)}" if found else "")
    return f"there is no folder {' or '.join(files.folders) or 'for them'} in {shown(root)}"
