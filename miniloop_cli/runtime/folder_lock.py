"""One run an output folder: a lock that dies with its process."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from miniloop_cli.errors import MiniloopError


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Hold `folder` (made if need be) for this process; an empty folder is removed again if the run fails.

    The kernel releases the lock when the process ends, however it ends, so nothing stale is left behind.
    Raises MiniloopError if another process holds it or it cannot be made.
    """
    path = folder / ".lock"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = path.open("w")
    except OSError as error:
        raise MiniloopError(f"cannot write to {folder}: {error.strerror or error}; choose another -o") from error
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            held = os.fstat(file.fileno()).st_ino == path.stat().st_ino
        except (BlockingIOError, FileNotFoundError):
            held = False  # another run holds it, or removed it between our opening and our locking
        if not held:
            raise MiniloopError(f"{folder} is in use by another run; wait for it or choose another -o")
        try:
            yield
        finally:
            path.unlink(missing_ok=True)
            with suppress(OSError):
                folder.rmdir()  # succeeds only while nothing was written
    finally:
        file.close()
