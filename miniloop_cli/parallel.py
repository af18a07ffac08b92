"""All cores, bounded: one ordered parallel map over threads.

Everything heavy here (OpenCV, matrix products, compiled kernels) releases the interpreter lock, so threads share
their inputs without copies. Inner threads are held at one, so that jobs times cores never exceeds the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from joblib import Parallel, delayed, effective_n_jobs
from threadpoolctl import threadpool_limits

from miniloop_cli.progress import track

Item, Result = TypeVar("Item"), TypeVar("Result")


@contextmanager
def single_inner_threads() -> Iterator[None]:
    """Libraries work in the thread that calls them, inside this block.

    Our matrices are small: a library's threads would wait for each other, spinning, longer than they work; and sums
    cut into as many parts as there are cores would give every machine its own last digits.
    """
    import cv2

    cv2.setNumThreads(1)
    with threadpool_limits(1):
        yield


@dataclass(frozen=True)
class Workers:
    """How work is spread: `jobs` threads (-1: one a core), and whether progress is shown."""

    jobs: int = -1
    quiet: bool = True

    @property
    def threads(self) -> int:
        """Number of jobs, resolved."""
        return effective_n_jobs(self.jobs)

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item], description: str, total: int
    ) -> Iterator[Result]:
        """function(item) for each item, in the order of the items, whatever the number of jobs."""
        with single_inner_threads():
            parallel = Parallel(n_jobs=self.jobs, backend="threading", return_as="generator")
            yield from track(parallel(delayed(function)(item) for item in items), description, total, self.quiet)
