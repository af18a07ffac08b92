"""Work on an existing Dask cluster, through joblib's dask backend; see docs/cluster.md."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from miniloop_cli.errors import MiniloopError
from miniloop_cli.runtime.code_version import code_version
from miniloop_cli.runtime.parallel import single_inner_threads

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")

ANSWER_S = 10  # longest wait for an answer of the scheduler or its first worker
REPLACED_S = 30  # longest wait for a new worker in place of one that died
CONTINUES = "finished work is kept, the same command continues, also without --cluster"
SENDS = 4  # of the same package without a result
BATCH = 32  # largest number of items of a task, which is repeated if a worker dies


@dataclass(frozen=True)
class Cluster:
    """A connected cluster; `client` is a distributed.Client; longest waits for answers, and for a new worker."""

    client: Any
    answer_s: float = ANSWER_S
    replaced_s: float = REPLACED_S

    def map(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[Result]:
        """function(shared, item) for each item, in order. `shared` is sent to every worker once, items in batches.

        Dask gives the tasks of a worker that dies to the others; if `shared` is lost with it, it is sent again with the
        rest of the items to the workers that exist within `replaced_s`. `function` must be importable there.
        Raises MiniloopError if the scheduler or all workers are lost, or if several workers die at one task.
        """
        items, done, sends = list(items), 0, SENDS
        with _told_in_one_line(self.client.scheduler.address):
            while done < len(items):
                try:
                    for result in self._map(function, shared, items[done:]):
                        done, sends = done + 1, SENDS
                        yield result
                except (OSError, CancelledError):  # also of a connection to a worker that is just dying
                    sends -= 1
                    if not sends:
                        raise
                    _greet(self.client.scheduler.address, self.answer_s)
                    self.client.wait_for_workers(1, timeout=self.replaced_s)

    def _map(self, function: Callable[[Shared, Item], Result], shared: Shared, items: list[Item]) -> Iterator[Result]:
        from joblib import Parallel, delayed

        size = max(1, min(BATCH, len(items) // (4 * sum(self.client.ncores().values()) or 1)))
        batches = [items[k : k + size] for k in range(0, len(items), size)]
        package = [shared]  # a list is sent unchanged
        with self._holding(package):
            parallel = Parallel(n_jobs=-1, batch_size=1, pre_dispatch="3*n_jobs", return_as="generator")
            for results in parallel(delayed(_work)(function, package, batch) for batch in batches):
                yield from results

    def _holding(self, package: list[Any]) -> AbstractContextManager:
        """joblib's dask backend, with `package` on every worker. Raises CommClosedError if one dies meanwhile."""
        from distributed.comm.core import CommClosedError
        from joblib import parallel_config

        try:
            return parallel_config(
                "dask", client=self.client, scatter=[package], wait_for_workers_timeout=self.answer_s
            )
        except (KeyError, TimeoutError) as error:  # a worker left before its turn, or there is none
            raise CommClosedError(f"a worker has left ({error})") from error


def _work(function: Callable[[Shared, Item], Result], package: list[Shared], batch: list[Item]) -> list[Result]:
    with single_inner_threads():
        return [function(package[0], item) for item in batch]


@contextmanager
def _told_in_one_line(address: str) -> Iterator[None]:
    """Raise dask's errors for lost connections and workers as a MiniloopError."""
    from distributed import KilledWorker

    try:
        yield
    except KilledWorker as error:
        why = "several workers died over the same work, perhaps for want of memory"
        raise MiniloopError(f"--cluster {address}: {why}; {CONTINUES}") from error
    except (OSError, TimeoutError, CancelledError) as error:
        why = f"the scheduler or its last worker is lost ({type(error).__name__})"
        raise MiniloopError(f"--cluster {address}: {why}; {CONTINUES}") from error


@contextmanager
def connected(address: str, answer_s: float = ANSWER_S, replaced_s: float = REPLACED_S) -> Iterator[Cluster]:
    """The cluster whose scheduler listens at an address, e.g. tcp://scheduler:8786; the times are those of `Cluster`.

    Raises MiniloopError if distributed is not installed, the scheduler does not answer, there is no worker, or a worker
    has another version of the code.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise MiniloopError(f"--cluster needs dask ({error}): pip install 'miniloop[cluster]'") from error
    try:
        _greet(address, answer_s)
        client = Client(address, timeout=answer_s, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise MiniloopError(
            f"--cluster {address}: no scheduler answers within {answer_s} s ({why}); start one with `dask scheduler` "
            "and give the address that it prints"
        ) from error
    with _without_log_lines(), client:
        _check_workers(client, address, answer_s)
        yield Cluster(client, answer_s, replaced_s)


@contextmanager
def _without_log_lines() -> Iterator[None]:
    """Suppress dask's log lines on lost connections and workers, which our own message replaces."""
    names = [n for n in logging.root.manager.loggerDict if n.partition(".")[0] in ("distributed", "tornado", "asyncio")]
    held = [logger for logger in map(logging.getLogger, names) if not logger.disabled]
    for logger in held:
        logger.disabled = True
    try:
        yield
    finally:
        for logger in held:
            logger.disabled = False


def _greet(address: str, answer_s: float) -> None:
    """Connect once; TimeoutError if it takes too long, as a client waits for ever for a silent peer."""
    from distributed.comm.core import connect

    async def greet() -> None:
        comm = await asyncio.wait_for(connect(address, timeout=answer_s), answer_s)
        comm.abort()

    with ThreadPoolExecutor(1) as thread:  # the caller's thread may be a notebook's, with its own event loop
        thread.submit(asyncio.run, greet()).result()


def _check_workers(client: Any, address: str, answer_s: float) -> None:
    try:
        client.wait_for_workers(1, timeout=answer_s)
    except TimeoutError:
        raise MiniloopError(f"--cluster {address}: no worker; start one with `dask worker {address}`") from None
    found = client.run(_version_here, on_error="return")
    for worker, version in sorted(found.items()):
        if isinstance(version, Exception):
            raise MiniloopError(f"--cluster {address}: worker {worker} cannot import miniloop ({version})")
        if version != code_version():
            raise MiniloopError(
                f"--cluster {address}: worker {worker} has another version of miniloop; install the same"
            )


def _version_here() -> str:
    return code_version()
