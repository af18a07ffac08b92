"""A function that workers of a test's cluster import."""

import os
import signal
from pathlib import Path

FATAL = 17


def die_once(marker: Path, item: int) -> int:
    """The square of an item; the first process that meets FATAL is gone, without a word."""
    if item == FATAL and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return item**2
