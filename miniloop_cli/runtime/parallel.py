"""All cores, bounded: one ordered parallel map over threads.

All heavy work (OpenCV, matrix products, compiled kernels) releases the interpreter lock, so threads share their inputs
without copies. Libraries use one inner thread each, so that the number of threads is that of the jobs.
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

import_module("scipy.linalg")  # its BLAS is not numpy's, and must be loaded before it can be limited to one thread

ROOM_BYTES = 128 << 20

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")


class Cluster(Protocol):
    """Machines that take part in the work (runtime.dask_cluster)."""

    def map(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterable[Result]:
        """function(shared, item) for each item, in order."""
        ...


class _OneThread:
    """Limits libraries to one thread while any block is active.

    Blocks of several threads, and those of suspended generators, end in any order. Therefore the last block that ends
    undoes the changes of all, in reverse order.
    """

    def __init__(self, hold: Callable[[], AbstractContextManager[object]]) -> None:
        self._hold = hold
        self._blocks = 0
        self._found = ExitStack()
        self._lock = (
            threading.RLock()
        )  # reentrant, as an abandoned generator may be closed in the middle of either half

    @contextmanager
    def block(self) -> Iterator[None]:
        with self._lock:
            self._blocks += 1
            self._found.enter_context(self._hold())  # in every block, as a library may have been loaded since the first
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
            # Newer versions restore limits only in the thread that set them first; here it may be any thread.
            getattr(OpenBLASController, "clear_controlling_thread", lambda force: None)(force=True)


class _Openmp(threading.local):
    """OpenMP has a number of threads for each calling thread."""

    def __init__(self) -> None:
        self.held = _OneThread(lambda: threadpool_limits(1, user_api="openmp"))


_PROCESS = _OneThread(_opencv_and_blas)
_OPENMP = _Openmp()


@contextmanager
def single_inner_threads() -> Iterator[None]:
    """Inside this block, libraries use only the calling thread; afterwards as many threads as before.

    Our matrices are small: threads of a library would mostly wait for each other. And sums that are split by the number
    of cores would have other last digits on each machine.

    Raises MemoryError if the process can allocate hardly any memory, as OpenBLAS would then retry for ever.
    """
    try:
        mmap.mmap(-1, ROOM_BYTES).close()
    except OSError as error:
        raise MemoryError(str(error)) from error
    with _PROCESS.block(), _OPENMP.held.block():
        yield


@dataclass(frozen=True)
class Workers:
    """The workers: `jobs` threads (-1: one a core), or a cluster; and whether progress is shown."""

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
        """function(item) for each item, in the order of the items, for any number of jobs.

        When the loop over the results ends, for any reason, no item is being processed: the interpreter would stop
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
        """function(shared, item) for each item, in order: on the cluster if there is one, else as by `map`.

        `function` must be importable, and depend on its arguments only, as it may run on another machine.
        """
        if self.cluster is None:
            return self.map(partial(function, shared), items, description, total)
        return track(self.cluster.map(function, shared, items), description, total, self.quiet)


def _in_order(function: Callable[[Item], Result], items: Iterable[Item], threads: int) -> Iterator[Result]:
    """Results in order; enough items are started in advance that one slow item does not leave threads idle.

    joblib's `return_as="generator"` does not replace this: it works ahead without bound, and items are still processed
    after its generator is closed.
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
