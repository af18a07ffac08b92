"""Loops over long arrays in blocks of fixed length, on several threads.

The blocks do not depend on the number of threads, and their results come in order. Hence a sum of parts has the same
bytes for any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any, TypeVar

BLOCK = 1 << 16
"""Rows of a block: work of a millisecond, beside which a thread's start costs little, on memory that caches hold."""

Part = TypeVar("Part")


class Blocks:
    """Up to `jobs` threads that share loops; they end with the `with` block. One job: the calling thread."""

    def __init__(self, jobs: int = 1) -> None:
        self._pool = ThreadPoolExecutor(jobs) if jobs > 1 else None

    def __enter__(self) -> Blocks:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def map(self, work: Callable[..., Part], count: int, *arguments: Any) -> list[Part]:
        """work(low, high, *arguments) of each block of rows low..high of `count`, in order.

        `work` releases the interpreter lock, and writes to no row outside its block.
        """
        bounds = [(low, min(low + BLOCK, count)) for low in range(0, count, BLOCK)]
        if self._pool is None or len(bounds) < 2:
            return [work(*block, *arguments) for block in bounds]
        return list(self._pool.map(lambda block: work(*block, *arguments), bounds))


ONE_THREAD = Blocks()
