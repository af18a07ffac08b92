"""`njit` for the kernels of this package: numba's, with a cache that cannot become stale."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from types import FunctionType
from typing import Any

import numba
from filelock import FileLock, Timeout
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

from miniloop_cli.runtime.kernel_cache import PACKAGE, kernels_folder, sources_hash

PATIENCE_S = 30.0  # longer than any kernel takes


def njit(*, cache: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """numba.njit. With `cache`, compiled code is kept in `kernels_folder()`, if there is one.

    numba's `cache=True` chooses a folder by settings of the whole process, and checks for changes in the kernel's own
    file only. The cache of a dispatcher is a separate object, which this package replaces.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        kernel: Any = numba.njit(**options)(function)
        # Not under NUMBA_DISABLE_JIT, where it is the plain function; nor in a module that cannot be imported again.
        if cache and kernel is not function and function.__module__ in sys.modules:
            with suppress(OSError):  # without a folder, each process compiles for itself
                kernel._cache = KernelCache(function)
        return kernel

    return compiled


class KernelLocator(_CacheLocator):
    """The cache file of one kernel, which is valid while the sources of all kernels are unchanged."""

    def __init__(self, function: FunctionType, path: str) -> None:
        folder = kernels_folder()
        if folder is None:
            raise OSError("no folder for compiled kernels can be written")
        packages = function.__module__.split(".")[1:-1]  # numba names the file by the module
        self._path = os.fspath(folder.joinpath(*packages))
        self._line = function.__code__.co_firstlineno
        self._py_file = path  # numba names it if a kernel cannot be cached

    def get_cache_path(self) -> str:
        """The folder that numba reads and writes."""
        return self._path

    def get_source_stamp(self) -> str:
        """The stamp that numba compares with that of cached code."""
        return sources_hash(PACKAGE)

    def get_disambiguator(self) -> str:
        """Distinguishes functions of one name in one file."""
        return str(self._line)

    @classmethod
    def from_function(cls, function: FunctionType, path: str) -> KernelLocator:
        """The locator of a function. Raises OSError if it cannot be cached."""
        locator = cls(function, path)
        locator.ensure_cache_path()
        return locator


class KernelCacheImpl(CompileResultCacheImpl):
    """numba's serialisation of a compiled function, in our folder."""

    def __init__(self, function: FunctionType) -> None:
        self._locator_classes = [KernelLocator]
        super().__init__(function)


class KernelCache(FunctionCache):
    """numba's cache of one compiled function, in our folder.

    A process waits for a kernel that another one is compiling, e.g. the warm-up of a first run. No two processes wait
    for each other, as kernels call each other in one direction only.
    """

    _impl_class = KernelCacheImpl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._lock = FileLock(f"{self.cache_path}/{self._impl.filename_base}.lock", timeout=PATIENCE_S)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled kernel; None if this process has to compile it. Then it holds the lock until it is saved."""
        if (found := super().load_overload(sig, target_context)) is not None:
            return found
        with suppress(OSError, Timeout, NotImplementedError):  # the process that holds it may be paused
            self._lock.acquire()
            found = super().load_overload(sig, target_context)
        if found is not None:
            self._lock.release(force=True)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a kernel that was compiled, and release the lock."""
        try:
            super().save_overload(sig, data)
        finally:
            self._lock.release(force=True)
