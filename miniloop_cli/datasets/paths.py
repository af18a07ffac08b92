"""Safe access to the files of a recording: inside its folder, ordinary files, of bounded size."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from miniloop_cli.errors import InputError, printable

MAX_TABLE_BYTES = 64 << 20  # an hour of motion capture at 100 Hz is 25 MB
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".ppm", ".pgm", ".pnm", ".tif", ".tiff", ".bmp")
DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".pgm", ".pnm", ".npy", ".npz", ".exr")
LINE_END = re.compile(r"\r\n|\r|\n")
UTF_16 = (b"\xff\xfe", b"\xfe\xff")


def shown(path: Path | str) -> str:
    """A path for messages and reports: printable for any bytes in the name, and of limited length."""
    return printable(os.fspath(path), 300)


@contextmanager
def open_file(path: Path, limit: int = MAX_TABLE_BYTES) -> Iterator[BinaryIO]:
    """An ordinary file of at most `limit` bytes, open for reading.

    Raises InputError for a missing, unreadable, oversized or special file (a pipe would block for ever), also if
    reading fails later.
    """
    try:
        if not path.is_file():
            what = "is a folder" if path.is_dir() else "is not an ordinary file" if path.exists() else "does not exist"
            raise InputError(f"{shown(path)} {what}")
        if (size := path.stat().st_size) > limit:
            raise InputError(f"{shown(path)} has {size / 2**20:.0f} MB, more than the {limit / 2**20:g} MB allowed")
        with path.open("rb") as file:
            yield file
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise InputError(f"cannot read {shown(path)}: {getattr(error, 'strerror', None) or error}") from error


def read_bytes(path: Path, limit: int = MAX_TABLE_BYTES) -> bytes:
    """The content of an ordinary file of at most `limit` bytes. Raises InputError as `open_file`."""
    with open_file(path, limit) as file:
        return file.read()


def read_lines(path: Path) -> list[tuple[int, str]]:
    """(line number, text) of every line of a text file that is not empty and not a comment (#).

    UTF-16 is recognised by its first two bytes. Bytes that are not UTF-8 become surrogates, so that file names of any
    encoding can be opened.
    """
    data = read_bytes(path)
    if data.startswith(UTF_16):
        text = data.decode("utf-16", "replace")
    else:
        text = data.decode("utf-8-sig", "surrogateescape")
    lines = ((number, line.strip()) for number, line in enumerate(LINE_END.split(text), 1))
    return [(number, line) for number, line in lines if line and not line.startswith("#")]


def within(root: Path, name: str, where: str) -> Path:
    """The path of `name` below `root`, by its text alone: links are not followed, and the file need not exist.

    Raises InputError naming `where` (file and line) for a name that points outside.
    """
    base = os.path.normpath(root)
    try:
        path = os.path.normpath(root / name)  # removes "..", which Path keeps
        if os.path.commonpath((base, path)) != base:
            raise InputError(
                f"{where} points outside the sequence: {shown(name)}; copy the files into {shown(root)} instead"
            )
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        pass  # it need not exist, and may be in an archive
    except (OSError, ValueError) as error:  # a name too long, a zero byte
        raise InputError(f"{where} names an impossible file: {shown(name)} ({error})") from error
    return root / os.path.relpath(path, base)


def require_inside(root: Path, paths: Iterable[Path]) -> None:
    """Raise InputError for the first of the files below `root` that is outside of it by a symbolic link."""
    base = os.path.realpath(root)
    real: dict[Path, str] = {}  # of the folders, which are few
    for path in paths:
        folder = real.setdefault(path.parent, os.path.realpath(path.parent))
        target = os.path.realpath(path) if path.is_symlink() else folder
        if os.path.commonpath((base, target)) != base:
            raise InputError(
                f"{shown(path)} points outside the sequence, to {shown(target)}; allow it with --follow-links, or "
                f"copy the files into {shown(root)}"
            )


def list_files(root: Path, folder: str, suffixes: tuple[str, ...] = IMAGE_SUFFIXES) -> tuple[list[Path], list[Path]]:
    """The files of a sub-folder of `root` that end in one of `suffixes`, and the others, sorted; hidden ones left out.

    Raises InputError if the folder cannot be listed.
    """
    where = root / folder
    try:
        entries = os.scandir(where) if type(where) is type(Path()) else where.iterdir()  # an archive's has no entries
        names = sorted(e.name for e in entries if e.name[0] != "." and not e.is_dir())
    except OSError as error:
        raise InputError(f"cannot list {shown(where)}: {error.strerror or error}") from error
    fitting = {name for name in names if name.lower().endswith(suffixes)}
    return [where / name for name in names if name in fitting], [where / n for n in names if n not in fitting]
