"""Paths into an archive: `rec.zip/rgb/1.png` reads as if the archive were a folder, so every layout can open it."""

from __future__ import annotations

import os
import stat
from collections.abc import Generator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Self

from miniloop_cli.datasets.archives import (
    ARCHIVE_SUFFIXES,
    COMPRESSED_TARS,
    Archive,
    is_archive,
    open_archive,
    unpacked_path,
)
from miniloop_cli.datasets.paths import shown
from miniloop_cli.scene.sequence import Note, NoteKind, Sequence

if TYPE_CHECKING:
    Base = Path
else:
    Base = type(Path())
HIDDEN = ("__MACOSX",)


class ArchivePath(Base):
    """A file or folder inside an archive: a path with the methods that readers of recordings use.

    It is a plain value (picklable, compared by its text); the archive is kept open by `archives`. Errors of reading are
    OSErrors, as with ordinary paths.
    """

    __slots__ = ()

    def _place(self) -> tuple[Archive, str]:
        text = os.fspath(self)
        archive = archive_of(text)
        return open_archive(archive), text[len(archive) :].strip(os.sep).replace(os.sep, "/")

    def exists(self, **_: Any) -> bool:
        return self.is_file() or self.is_dir()

    def is_file(self, **_: Any) -> bool:
        archive, name = self._place()
        return name in archive.sizes

    def is_dir(self, **_: Any) -> bool:
        archive, name = self._place()
        return name in archive.folders or not name

    def is_symlink(self) -> bool:
        return False

    def stat(self, **_: Any) -> os.stat_result:
        archive, name = self._place()
        if name not in archive.sizes and name not in archive.folders:
            raise FileNotFoundError(2, "No such file in the archive", os.fspath(self))
        kind = stat.S_IFREG if name in archive.sizes else stat.S_IFDIR
        return os.stat_result((kind | 0o444, 0, 0, 1, 0, 0, archive.sizes.get(name, 0), 0, 0, 0))

    def iterdir(self) -> Generator[Self, None, None]:
        archive, name = self._place()
        if name and name not in archive.folders:
            raise NotADirectoryError(20, "Not a folder in the archive", os.fspath(self))
        yield from (self / child for child in archive.folders.get(name, ()))

    def glob(self, pattern: str, **_: Any) -> Generator[Self, None, None]:
        """By the names; `**` is not supported and raises NotImplementedError."""
        from fnmatch import fnmatchcase

        first, _slash, rest = pattern.partition("/")
        if "**" in pattern:
            raise NotImplementedError("** in an archive")
        if not self.is_dir():
            return
        for child in self.iterdir():
            if fnmatchcase(child.name, first):
                if rest:
                    yield from child.glob(rest)
                else:
                    yield child

    def open(self, mode: str = "r", *args: Any, **kwargs: Any) -> IO[Any]:  # type: ignore[override]
        """Open for reading, as text or bytes. Raises FileNotFoundError, and PermissionError for writing."""
        import io

        archive, name = self._place()
        if mode not in ("r", "rt", "rb"):
            raise PermissionError(13, "An archive is only read", os.fspath(self))
        if name not in archive.sizes:
            raise FileNotFoundError(2, "No such file in the archive", os.fspath(self))
        file = archive.open_member(name)
        return file if mode == "rb" else io.TextIOWrapper(file, *args[1:], **kwargs)


def archive_of(text: str) -> str:  # of a string: Path.is_file of a path into an archive would ask here again
    """The path of the archive that a path points into. Raises FileNotFoundError if no part of it is a file."""
    return text if os.path.isfile(text) else _archive_of_folder(os.path.dirname(text))  # noqa: PTH113, PTH120


@lru_cache(maxsize=4096)
def _archive_of_folder(text: str) -> str:
    while not os.path.isfile(text):  # noqa: PTH113
        text, last = os.path.dirname(text), text  # noqa: PTH120
        if text == last:
            raise FileNotFoundError(2, "No such archive", text)
    return text


def levels(path: Path) -> list[ArchivePath]:
    """The folders that may be the recording in an archive: its top, the one folder in that, the one in that ...

    Raises InputError for an archive that is damaged or unsafe.
    """
    folder = ArchivePath(path)
    open_archive(path)
    found = [folder]
    while True:
        names = [child for child in folder.iterdir() if child.name[0] != "." and child.name not in HIDDEN]
        if len(names) != 1 or not names[0].is_dir():
            return found
        folder = names[0]
        found.append(folder)


def inside(path: Path) -> ArchivePath:
    """The recording's folder in an archive: its top, or the last of a chain of single folders. Raises InputError."""
    return levels(path)[-1]


def entered(path: Path) -> Path:
    """The path as an ArchivePath if it points into an archive, as the root of a recording in one does."""
    if path.exists():
        return path
    try:
        archive = archive_of(os.fspath(path))
    except (OSError, ValueError):  # ValueError: a zero byte in the name
        return path
    return ArchivePath(path) if is_archive(Path(archive)) else path


def from_archive(sequence: Sequence, root: ArchivePath) -> Sequence:
    """A sequence that was read from an archive: its name without the suffix, with notes on the archive."""
    path = Path(archive_of(os.fspath(root)))
    archive, name = open_archive(path), sequence.name
    if root == path:
        suffix = next((suffix for suffix in ARCHIVE_SUFFIXES if name.lower().endswith(suffix)), path.suffix)
        name = name[: -len(suffix)]
    notes = list(sequence.notes)
    if path.name.lower().endswith(COMPRESSED_TARS):
        text = f"{shown(path.name)} is decompressed to {shown(unpacked_path(path))}; `miniloop cache prune` removes it"
        notes.append(Note(NoteKind.CONVERTED, text))
    if archive.links:
        text = f"{archive.links} members of {shown(path.name)} are links or of other kinds than files: not followed"
        notes.append(Note(NoteKind.DROPPED, text))
    return replace(sequence, name=name, notes=tuple(notes))


__all__ = ["ArchivePath", "entered", "from_archive", "inside", "is_archive"]
