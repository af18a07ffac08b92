"""The C library's allocator: images are allocated and freed often, and new pages cost time."""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import suppress

KEPT_BYTES = 64 << 20  # freed memory that a process keeps for the next image
KEPT_FOR_MAPS_BYTES = (2 << 30) - 1  # for the next adjustment of a map
# Constants of glibc's malloc.h, and the environment variables for the same settings.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
OF_USERS = "MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_", "MALLOC_ARENA_MAX", "GLIBC_TUNABLES"


def keep_freed_memory(kept_bytes: int = KEPT_BYTES) -> bool:
    """Let this process keep up to so much freed memory; True if its C library is glibc and accepted it.

    For the command line, as it affects the whole process. Settings by environment variables have precedence.
    Source: mallopt(3).
    """
    if not sys.platform.startswith("linux") or any(name in os.environ for name in OF_USERS):
        return False
    with suppress(OSError, AttributeError):  # another C library, which has no mallopt
        mallopt = ctypes.CDLL(None).mallopt
        # Otherwise each thread keeps freed memory of its own.
        settings = {M_TRIM_THRESHOLD: kept_bytes, M_MMAP_THRESHOLD: kept_bytes, M_ARENA_MAX: 1}
        return all(mallopt(option, value) == 1 for option, value in settings.items())
    return False


def give_back_freed_memory() -> None:
    """Return the pages between live objects to the system, where the C library is glibc.

    For use before work that needs much memory: many small arrays of different ages leave such pages. Source:
    malloc_trim(3).
    """
    if sys.platform.startswith("linux"):
        with suppress(OSError, AttributeError):  # another C library, which has no malloc_trim
            ctypes.CDLL(None).malloc_trim(0)
