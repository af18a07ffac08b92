"""A lock on an output folder, which is released when its process ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from miniloop_cli.errors import MiniloopError


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Hold `folder` (made if need be) for this process; an empty folder is removed again if the run fails.

    The system releases the lock when the process ends, however it ends, so nothing stale is left behind.
    Raises MiniloopError if another process holds it or it cannot be made.
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
            removed = _removed(path)  # while the lock is held: afterwards it may be another run's
            lock.release()
            if not removed:
                _removed(path)  # Windows removes no file that is open
    finally:
        lock.release()  # also where the file was another than the one that we opened


def _acquired(lock: FileLock, inode: int) -> bool:
    """Whether the lock is ours, and on the file that has its name.

    Another run may hold it, or may have removed the file after we opened it and before we locked it.
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
