"""Files of a recording, which somebody else made: inside its folder, ordinary, of bounded size."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from miniloop_cli.errors import InputError, printable

MAX_TABLE_BYTES = 64 << 20  # an hour of motion capture at 100 Hz is 25 MB
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")


def shown(path: Path | str) -> str:
    """A path for messages and reports: printable whatever bytes the name holds, and not endless."""
    return printable(os.fspath(path), 300)


@contextmanager
def open_file(path: Path, limit: int = MAX_TABLE_BYTES) -> Iterator[BinaryIO]:
    """An ordinary file of at most `limit` bytes, open for reading.

    Raises InputError for a missing, unreadable, oversized or special file (a pipe would block for ever), also where
    reading fails later on.
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

    Bytes that are not UTF-8 survive as surrogates, so that file names of any encoding still open.
    """
    text = read_bytes(path).decode("utf-8-sig", "surrogateescape")
    lines = ((number, line.strip()) for number, line in enumerate(text.split("\n"), 1))
    return [(number, line) for number, line in lines if line and not line.startswith("#")]


def inside(root: Path, name: str, where: str) -> Path:
    """The path of `name` within `root`, which must stay there, also after following symbolic links.

    Raises InputError naming `where` (file and line) otherwise. The file itself need not exist.
    """
    try:
        path = root / name
        base = os.path.realpath(root)
        if os.path.commonpath((base, os.path.realpath(path))) != base:
            raise InputError(
                f"{where} points outside the sequence: {shown(name)}; copy the files into {shown(root)} instead"
            )
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise InputError(f"{where} names an impossible file: {shown(name)} ({error})") from error
    return path


def list_images(root: Path, folder: str, suffixes: tuple[str, ...] = IMAGE_SUFFIXES) -> list[Path]:
    """The images of a sub-folder of `root`, sorted by name; hidden files left out.

    Raises InputError where the folder or one of its files is a link that leads outside.
    """
    where = inside(root, folder, f"the folder {shown(folder)}")
    try:
        names = sorted(e.name for e in os.scandir(where) if e.name.lower().endswith(suffixes) and e.name[0] != ".")
    except OSError as error:
        raise InputError(f"cannot list {shown(where)}: {error.strerror or error}") from error
    return [inside(root, f"{folder}/{name}", f"{shown(where)}/{shown(name)}") for name in names]
