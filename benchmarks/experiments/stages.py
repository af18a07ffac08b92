"""Wall-clock and CPU seconds of each stage of a run; of work done earlier in the same session, what it took then."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from numpy.typing import NDArray

from miniloop_cli.runtime.artifact_store import Arrays, Store

Key = tuple[str, str]


class Seconds(NamedTuple):
    """What a stage took: `cpu` is user and system time of the process, all its threads."""

    wall: float
    cpu: float


class StageClock(logging.Handler):
    """Seconds of each stage, read off the begin and end that the pipeline writes to its log."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.seconds: dict[str, Seconds] = {}
        self._begun: dict[str, Seconds] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Note the time where a stage begins or ends."""
        if not isinstance(record.args, tuple) or not record.args:
            return
        name, now = str(record.args[0]), Seconds(time.perf_counter(), time.process_time())
        if record.msg == "%s ...":
            self._begun[name] = now
        elif record.msg == "%s: %.1f s" and name in self._begun:
            begun = self._begun.pop(name)
            self.ended(name, Seconds(now.wall - begun.wall, now.cpu - begun.cpu))

    def ended(self, name: str, seconds: Seconds) -> None:
        """A stage has ended after so many seconds."""
        self.seconds[name] = seconds

    @contextmanager
    def listening(self) -> Iterator[None]:
        """While this lasts, the pipeline's log is heard; it is shown to nobody who did not see it before."""
        log = logging.getLogger("miniloop")
        level, propagate = log.level, log.propagate
        log.propagate = propagate and log.isEnabledFor(logging.INFO)
        log.setLevel(logging.INFO)
        log.addHandler(self)
        try:
            yield
        finally:
            log.removeHandler(self)
            log.setLevel(level)
            log.propagate = propagate


IN_MEMORY = ("matches", "edges")


@dataclass(frozen=True)
class SessionStore(Store):
    """Features come from disk and are kept there; matches and edges are made once a session, and kept in memory.

    What later stages keep is made every time: they would share parts of it, and show less than a run of their own.

    `paid`: what each stage took that made its artefacts; `touched`: artefacts that the running stage asked for.
    """

    made: dict[Key, Arrays] = field(default_factory=dict)
    paid: dict[tuple[str, frozenset[Key]], Seconds] = field(default_factory=dict)
    touched: set[Key] = field(default_factory=set)

    def load(self, kind: str, key: str) -> dict[str, NDArray[Any]] | None:
        """As Store.load."""
        if kind not in ("features", *IN_MEMORY):
            return None
        self.touched.add((kind, key))
        if kind == "features":
            return super().load(kind, key)
        kept = self.made.get((kind, key))
        return dict(kept) if kept is not None else None

    def save(self, kind: str, key: str, arrays: Arrays) -> None:
        """As Store.save."""
        if kind == "features":
            super().save(kind, key, arrays)
        elif kind in IN_MEMORY:
            self.made[kind, key] = arrays


class SessionClock(StageClock):
    """A stage whose artefacts were all made earlier in the session counts with what it took then."""

    def __init__(self, store: SessionStore) -> None:
        super().__init__()
        self.store = store

    def ended(self, name: str, seconds: Seconds) -> None:
        """The seconds of a stage without artefacts are always its own."""
        touched = frozenset(self.store.touched)
        self.store.touched.clear()
        self.seconds[name] = self.store.paid.setdefault((name, touched), seconds) if touched else seconds
