"""Files that are either whole or absent: written under a temporary name, then renamed."""

from __future__ import annotations

import os
import platform
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO, Any

from miniloop_cli.errors import MiniloopError

HOST = platform.node()
TEMPORARY = re.compile(r"\..+\.miniloop-(.+)-(\d+)\.tmp")
DAY_S = 86400.0
WINDOWS = os.name == "nt"
PATIENCE_S = 2.0 if WINDOWS else 0.0  # for a file that another process has open, which only Windows refuses to replace


def temporary_name(path: Path) -> Path:
    """The hidden file beside `path` into which this process writes."""
    return path.with_name(f".{path.name}.miniloop-{HOST}-{os.getpid()}.tmp")


@cache
def remove_leftovers(folder: Path, by_age: bool = WINDOWS) -> None:
    """Remove temporary files of killed processes of this machine from `folder`, once a process.

    `by_age`: a file not written to for a day is a leftover; else, a file without a living process.
    """
    with suppress(OSError):
        for entry in os.scandir(folder):
            match = TEMPORARY.fullmatch(entry.name)
            if not match or match[1] != HOST:
                continue
            if time.time() - entry.stat().st_mtime < DAY_S if by_age else _alive(int(match[2])):
                continue
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            else:
                Path(entry.path).unlink(missing_ok=True)


def _alive(pid: int) -> bool:
    """Whether a process runs. Not for Windows, where `os.kill` ends a process for any signal."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def replace(temporary: Path, path: Path, patience_s: float = PATIENCE_S) -> None:
    """Rename a file to `path`, replacing an existing file.

    Windows refuses while another process, such as a virus scanner, has either of them open; it is tried again for
    `patience_s`. Raises OSError.
    """
    give_up = time.monotonic() + patience_s
    while True:
        try:
            temporary.replace(path)
            return
        except PermissionError:
            if time.monotonic() >= give_up:
                raise
            time.sleep(0.05)


@contextmanager
def atomic_write(path: Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Open a temporary file beside `path`; on success it replaces `path`, on any error it is removed.

    Text is UTF-8; characters that cannot be encoded (file names of other encodings) are written as escapes.
    Raises MiniloopError if the folder cannot be written (no permission, disk full).
    """
    path = Path(path)
    temporary = temporary_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(path.parent)
        with _opened(temporary, mode) as file:
            yield file
            file.flush()
        replace(temporary, path)
    except OSError as error:
        raise MiniloopError(f"cannot write {path}: {error.strerror or error}; free some space or choose -o") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _opened(path: Path, mode: str) -> IO[Any]:
    if "b" in mode:
        return path.open(mode)
    return path.open(mode, encoding="utf-8", errors="backslashreplace", newline="\n")
