"""Containers that are slow to open (archives, videos, bags), kept open once a process."""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Generic, TypeVar

T = TypeVar("T")
MOST_OPEN = 4


class KeptOpen(Generic[T]):
    """The last few files that `open_it` opened; a file that has changed on disk is opened again.

    Files that are no longer kept are not closed here, as another thread may still read; they close with their last
    reference.
    """

    def __init__(self, open_it: Callable[[Path], T], most: int = MOST_OPEN) -> None:
        self._open, self._most = open_it, most
        self._kept: OrderedDict[tuple[str, int, int, int], T] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, path: Path | str) -> T:
        """The open container at `path`. Raises OSError if it does not exist, and the errors of `open_it`."""
        path = Path(path) if isinstance(path, str) else path
        state = path.stat()  # by its own class, as it may be in an archive
        # A forked process must not share a file's position.
        key = (os.fspath(path), os.getpid(), state.st_mtime_ns, state.st_size)
        with self._lock:
            if key not in self._kept:
                self._kept[key] = self._open(path)
                while len(self._kept) > self._most:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(key)
            return self._kept[key]
