"""`njit` for the kernels of this package: numba's, with compiled code kept where it cannot become stale."""

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

    numba's `cache=True` chooses a folder by settings of the whole process, and looks for changes in the kernel's own
    file only. A dispatcher's cache is an object of its own, so this package brings one.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        kernel: Any = numba.njit(**options)(function)
        # Not under NUMBA_DISABLE_JIT, where it is the bare function; nor of a module that nobody could import again.
        if cache and kernel is not function and function.__module__ in sys.modules:
            with suppress(OSError):  # where nothing can be kept, each process compiles for itself
                kernel._cache = KernelCache(function)
        return kernel

    return compiled


class KernelLocator(_CacheLocator):
    """Where the code of one kernel is kept, and what must be unchanged for it to be loaded: all kernels' sources."""

    def __init__(self, function: FunctionType, path: str) -> None:
        folder = kernels_folder()
        if folder is None:
            raise OSError("no folder for compiled kernels can be written")
        packages = function.__module__.split(".")[1:-1]  # numba names the file by the module
        self._path = os.fspath(folder.joinpath(*packages))
        self._line = function.__code__.co_firstlineno
        self._py_file = path  # where numba says that a kernel cannot be kept

    def get_cache_path(self) -> str:
        """The folder that numba reads and writes."""
        return self._path

    def get_source_stamp(self) -> str:
        """What numba compares with the stamp of kept code."""
        return sources_hash(PACKAGE)

    def get_disambiguator(self) -> str:
        """Tells functions of one name in one file apart."""
        return str(self._line)

    @classmethod
    def from_function(cls, function: FunctionType, path: str) -> KernelLocator:
        """The locator of a function. Raises OSError where nothing can be kept."""
        locator = cls(function, path)
        locator.ensure_cache_path()
        return locator


class KernelCacheImpl(CompileResultCacheImpl):
    """numba's way to keep a compiled function, at our place."""

    def __init__(self, function: FunctionType) -> None:
        self._locator_classes = [KernelLocator]
        super().__init__(function)


class KernelCache(FunctionCache):
    """numba's cache of one compiled function, at our place."""

    _impl_class = KernelCacheImpl
