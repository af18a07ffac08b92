"""Seconds of named stages."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager

LOG = logging.getLogger("miniloop")


class Stopwatch:
    """Seconds of named stages, in order: by the clock, and of the processor, all threads of the process together."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.cpu_seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the seconds of the block to a stage."""
        begin, begin_cpu = time.perf_counter(), time.process_time()
        LOG.info("%s ...", name)
        yield
        self.seconds[name] = round(self.seconds.get(name, 0.0) + time.perf_counter() - begin, 3)
        self.cpu_seconds[name] = round(self.cpu_seconds.get(name, 0.0) + time.process_time() - begin_cpu, 3)
        LOG.info("%s: %.1f s", name, self.seconds[name])
