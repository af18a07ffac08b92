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
    """The last few files that `open_it` opened; one that has changed on disk is opened again.

    What is no longer kept is not closed here, as another thread may still read from it: it closes when it is let go.
    """

    def __init__(self, open_it: Callable[[Path], T], most: int = MOST_OPEN) -> None:
        self._open, self._most = open_it, most
        self._kept: OrderedDict[tuple[str, int, int, int], T] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, path: Path | str) -> T:
        """The open container at `path`. Raises OSError where it is not there, and whatever `open_it` raises."""
        path = Path(path) if isinstance(path, str) else path
        state = path.stat()  # of its own class: it may lie in an archive
        # A forked process must not share a file's position.
        key = (os.fspath(path), os.getpid(), state.st_mtime_ns, state.st_size)
        with self._lock:
            if key not in self._kept:
                self._kept[key] = self._open(path)
                while len(self._kept) > self._most:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(key)
            return self._kept[key]
