"""What every stage is given beside its inputs: where finished work is kept, how work is spread, the seed."""

from __future__ import annotations

from dataclasses import dataclass

from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.parallel import Workers


@dataclass(frozen=True)
class Run:
    """One run of the pipeline. Neither store nor workers change what it computes."""

    store: Store
    workers: Workers
    seed: int = 0
