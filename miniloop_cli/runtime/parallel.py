"""All cores, bounded: one ordered parallel map over threads.

Everything heavy here (OpenCV, matrix products, compiled kernels) releases the interpreter lock, so threads share
their inputs without copies. Inner threads are held at one, so that jobs times cores never exceeds the machine.
"""

from __future__ import annotations

import mmap
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Protocol, TypeVar

from joblib import effective_n_jobs
from threadpoolctl import OpenBLASController, threadpool_limits

from miniloop_cli.runtime.progress import track

import_module("scipy.linalg")  # its BLAS is another than numpy's, and must be loaded to be held at one thread

ROOM_BYTES = 128 << 20

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")


class Cluster(Protocol):
    """Machines that work is sent to (runtime.dask_cluster)."""

    def map(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterable[Result]:
        """function(shared, item) for each item, in order."""
        ...


class _OneThread:
    """Libraries that are held at one thread while any block is at work.

    Blocks of several threads, and those of suspended generators, end in any order. So none gives back by itself what
    it found: the last one that ends undoes what all of them did, in reverse.
    """

    def __init__(self, hold: Callable[[], AbstractContextManager[object]]) -> None:
        self._hold = hold
        self._blocks = 0
        self._found = ExitStack()
        self._lock = threading.RLock()  # in the middle of either half, an abandoned generator may be closed

    @contextmanager
    def block(self) -> Iterator[None]:
        with self._lock:
            self._blocks += 1
            self._found.enter_context(self._hold())  # in every block: a library may have been loaded since the first
        try:
            yield
        finally:
            with self._lock:
                self._blocks -= 1
                if not self._blocks:
                    self._found.close()


@contextmanager
def _opencv_and_blas() -> Iterator[None]:
    import cv2

    found = cv2.getNumThreads()
    cv2.setNumThreads(1)
    with threadpool_limits(1, user_api="blas"):
        try:
            yield
        finally:
            cv2.setNumThreads(found)
            # Newer versions let no other thread give back than the one that limited first; here, it may be any.
            getattr(OpenBLASController, "clear_controlling_thread", lambda force: None)(force=True)


class _Openmp(threading.local):
    """OpenMP counts its threads for each thread that calls it."""

    def __init__(self) -> None:
        self.held = _OneThread(lambda: threadpool_limits(1, user_api="openmp"))


_PROCESS = _OneThread(_opencv_and_blas)
_OPENMP = _Openmp()


@contextmanager
def single_inner_threads() -> Iterator[None]:
    """Libraries work in the thread that calls them, inside this block; afterwards in as many as before it.

    Our matrices are small: a library's threads would wait for each other, spinning, longer than they work; and sums
    cut into as many parts as there are cores would give every machine its own last digits.

    Raises MemoryError where a process may hardly allocate any more: OpenBLAS would ask for ever.
    """
    try:
        mmap.mmap(-1, ROOM_BYTES).close()
    except OSError as error:
        raise MemoryError(str(error)) from error
    with _PROCESS.block(), _OPENMP.held.block():
        yield


@dataclass(frozen=True)
class Workers:
    """How work is spread: `jobs` threads (-1: one a core), a cluster where there is one; whether progress is shown."""

    jobs: int = -1
    quiet: bool = True
    cluster: Cluster | None = None

    @property
    def threads(self) -> int:
        """Number of jobs, resolved."""
        return effective_n_jobs(self.jobs)

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item], description: str, total: int
    ) -> Iterator[Result]:
        """function(item) for each item, in the order of the items, whatever the number of jobs.

        However the loop over the results ends, no item is at work any more afterwards: the interpreter would stop
        such threads in the middle of compiled code, which aborts the process.
        """
        with single_inner_threads():
            results = map(function, items) if self.threads == 1 else _in_order(function, items, self.threads)
            yield from track(results, description, total, self.quiet)

    def spread(
        self,
        function: Callable[[Shared, Item], Result],
        shared: Shared,
        items: Iterable[Item],
        description: str,
        total: int,
    ) -> Iterator[Result]:
        """function(shared, item) for each item, in order: on the cluster where there is one, else as `map` does.

        `function` belongs to a module, and draws on nothing but its arguments: it may run on another machine.
        """
        if self.cluster is None:
            return self.map(partial(function, shared), items, description, total)
        return track(self.cluster.map(function, shared, items), description, total, self.quiet)


def _in_order(function: Callable[[Item], Result], items: Iterable[Item], threads: int) -> Iterator[Result]:
    """Results in order; so many items are begun ahead that one slow item keeps no thread waiting.

    joblib's `return_as="generator"` is no substitute: it works ahead without bound, and items are still at work after
    its generator is closed.
    """
    begun: deque[Future[Result]] = deque()
    pool = ThreadPoolExecutor(threads)
    try:
        for item in items:
            begun.append(pool.submit(function, item))
            if len(begun) > 16 * threads:
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
