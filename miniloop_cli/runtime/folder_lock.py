"""A lock on an output folder, released at the end of its process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from miniloop_cli.errors import MiniloopError


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Hold `folder` (created if necessary) for this process; an empty folder is removed if the run fails.

    The system releases the lock when the process ends, also if it is killed.
    Raises MiniloopError if another process holds it or it cannot be created.
    """
    path = folder / ".lock"
    lock = FileLock(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = path.open("a")
    except OSError as error:
        raise MiniloopError(f"cannot write to {folder}: {error.strerror or error}; choose another -o") from error
    try:
        with file:
            if not _acquired(lock, os.fstat(file.fileno()).st_ino):
                raise MiniloopError(f"{folder} is in use by another run; wait for it or choose another -o")
        try:
            yield
        finally:
            removed = _removed(path)  # while the lock is held, as another run may hold it afterwards
            lock.release()
            if not removed:
                _removed(path)  # Windows does not remove open files
    finally:
        lock.release()  # also if the file was replaced after it was opened


def _acquired(lock: FileLock, inode: int) -> bool:
    """Whether this process has the lock, on the file with its name.

    Another run may hold it, or may have removed the file between opening and locking. Raises MiniloopError.
    """
    try:
        lock.acquire(timeout=0)
        return Path(lock.lock_file).stat().st_ino == inode
    except (Timeout, FileNotFoundError):
        return False
    except NotImplementedError as error:
        raise MiniloopError(f"cannot lock {lock.lock_file}: {error}; choose another -o") from error


def _removed(path: Path) -> bool:
    """Remove the lock's file, and its folder if nothing else was written; False if the file has to be closed first."""
    try:
        path.unlink(missing_ok=True)
    except PermissionError:
        return False
    with suppress(OSError):
        path.parent.rmdir()
    return True
