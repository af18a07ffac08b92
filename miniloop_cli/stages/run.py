"""The environment of every stage: the cache, the workers, the seed."""

from __future__ import annotations

from dataclasses import dataclass

from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.parallel import Workers


@dataclass(frozen=True)
class Run:
    """One run of the pipeline. Its results do not depend on store and workers."""

    store: Store
    workers: Workers
    seed: int = 0
