"""Finished work on disk: arrays named by a hash of what they were made from.

An artefact's name is a hash of its inputs, of the settings that matter to it and of the code's version, so that
nothing stale can be found, and a killed or repeated run finds what is done. Files are plain .npz, never unpickled,
with a checksum of the whole at the end (what a zip file checks by itself is not all of it); one that is damaged is
deleted and made again. All hashes are SHA-256, which most processors compute by themselves.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.errors import MiniloopError
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.runtime.cache_folder import cache_folder
from miniloop_cli.version import __version__

Arrays = Mapping[str, NDArray[Any]]
LIBRARIES = ("opencv-contrib-python-headless", "numpy", "scipy", "numba", "networkx", "mahotas")
CHECKSUM_BYTES = 32
SHOWING = ("cli", "report", "bench", "inspection", "evaluation")  # packages whose code is in no artefact


def default_folder() -> Path:
    """The user's cache folder. Raises MiniloopError if there is none."""
    return cache_folder()


@cache
def library_versions() -> dict[str, str]:
    """Versions of the libraries that results depend on."""
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found


@cache
def code_version() -> str:
    """Hash of release, libraries and the sources that artefacts are made by: a changed solver finds no old result."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256(json.dumps([__version__, library_versions()]).encode())
    for path in sorted(package.rglob("*.py")):
        if path.relative_to(package).parts[0] not in SHOWING:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def fingerprint(*parts: Any) -> str:
    """Hash of JSON-able parts and the code's version."""
    text = json.dumps([code_version(), *parts], sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def content_fingerprint(arrays: Iterable[NDArray[Any]]) -> str:
    """Hash of the types, shapes and bytes of arrays."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8))
    return digest.hexdigest()


def file_fingerprint(path: Path) -> str:
    """Hash of a file's content; of its absence where it cannot be read (the reader says why later)."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return "unreadable"


def checksum(content: memoryview) -> bytes:
    """The last bytes of an artefact's file: a hash of all before them."""
    return hashlib.sha256(content).digest()


@dataclass(frozen=True)
class Store:
    """A folder of artefacts; `fresh` makes everything again (and still keeps it)."""

    folder: Path
    fresh: bool = False

    def path(self, kind: str, key: str) -> Path:
        return self.folder / kind / f"{key}.npz"

    def load(self, kind: str, key: str) -> dict[str, NDArray[Any]] | None:
        """The arrays of an artefact, or None if it must be made."""
        path = self.path(kind, key)
        if self.fresh:
            return None
        try:
            content = path.read_bytes()
        except OSError:
            return None
        whole = memoryview(content)[:-CHECKSUM_BYTES]
        if checksum(whole) != content[-CHECKSUM_BYTES:]:
            with suppress(OSError):
                path.unlink(missing_ok=True)
            return None
        with suppress(OSError):  # of somebody else, or read-only
            os.utime(path)  # when it was last used: what pruning goes by
        with np.load(io.BytesIO(whole), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}

    def kept(self, kind: str, key: str, make: Callable[[], Arrays]) -> Arrays:
        """The arrays of an artefact; where there is none, made now and kept."""
        found = self.load(kind, key)
        if found is None:
            found = make()
            self.save(kind, key, found)
        return found

    def save(self, kind: str, key: str, arrays: Arrays) -> None:
        """Keep an artefact; a store that cannot be written costs the next run time, never this run its result."""
        try:
            packed = io.BytesIO()
            np.savez(packed, **arrays)
            with atomic_write(self.path(kind, key), "wb") as file:
                file.write(packed.getbuffer())
                file.write(checksum(packed.getbuffer()))
        except MiniloopError:
            return
