"""Files that are either whole or absent: written under a temporary name, then renamed."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO

from miniloop_cli.errors import MiniloopError

HOST = os.uname().nodename
TEMPORARY = re.compile(r"\..+\.miniloop-(.+)-(\d+)\.tmp")


def temporary_name(path: Path) -> Path:
    """The hidden neighbour of `path` under which this process makes it."""
    return path.with_name(f".{path.name}.miniloop-{HOST}-{os.getpid()}.tmp")


@cache
def remove_leftovers(folder: Path) -> None:
    """Remove, once a process, what killed processes of this machine left in `folder` under temporary names."""
    with suppress(OSError):
        for entry in os.scandir(folder):
            match = TEMPORARY.fullmatch(entry.name)
            if not match or match[1] != HOST or _alive(int(match[2])):
                continue
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            else:
                Path(entry.path).unlink(missing_ok=True)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


@contextmanager
def atomic_write(path: Path, mode: str = "w") -> Iterator[IO]:
    """Open a temporary neighbour of `path`; on success it replaces `path`, on any error it is removed.

    Text is UTF-8; what cannot be encoded (file names of other encodings) is written as an escape.
    Raises MiniloopError if the folder cannot be written (no permission, disk full).
    """
    path = Path(path)
    temporary = temporary_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(path.parent)
        text = {} if "b" in mode else {"encoding": "utf-8", "errors": "backslashreplace", "newline": "\n"}
        with temporary.open(mode, **text) as file:
            yield file
            file.flush()
        temporary.replace(path)
    except OSError as error:
        raise MiniloopError(f"cannot write {path}: {error.strerror or error}; free some space or choose -o") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
