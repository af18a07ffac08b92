"""`njit` for the kernels of this package: numba's, with a cache that cannot become stale."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from types import FunctionType
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

from miniloop_cli.runtime.kernel_cache import PACKAGE, kernels_folder, sources_hash


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
    """numba's cache of one compiled function, in our folder."""

    _impl_class = KernelCacheImpl
