"""The cache: finished work on disk as arrays, named by a hash of their inputs.

The name of an artefact is a hash of its kind, the version of what its stage computes, the versions of the libraries
and its inputs. So nothing stale is found, and a killed or repeated run continues from finished work. Files are plain
.npz, never unpickled, with a checksum of the whole at the end, as zip files do not check all of their bytes; a damaged
file is deleted and made again. All hashes are SHA-256, which most processors compute in hardware.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.errors import MiniloopError
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.runtime.cache_folder import cache_folder

Arrays = Mapping[str, NDArray[Any]]
LIBRARIES = ("opencv-contrib-python-headless", "numpy", "scipy", "numba", "networkx", "mahotas", "Pillow")
CHECKSUM_BYTES = 32


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


@dataclass(frozen=True)
class Artifact:
    """A kind of finished work, and the version of what computes it."""

    kind: str
    version: int


def fingerprint(*parts: Any) -> str:
    """Hash of nested JSON values, settings, dataclasses and arrays. Raises TypeError for anything else."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(part: Any) -> Any:
    if isinstance(part, np.ndarray):
        return content_fingerprint([part])
    if isinstance(part, np.generic):
        return part.item()
    if hasattr(part, "model_dump"):  # settings, recognised without importing pydantic
        return part.model_dump()
    if is_dataclass(part) and not isinstance(part, type):
        return {field.name: getattr(part, field.name) for field in fields(part)}
    raise TypeError(f"{type(part).__name__} cannot name an artefact")


def content_fingerprint(arrays: Iterable[NDArray[Any]]) -> str:
    """Hash of the types, shapes and bytes of arrays (...)."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def file_fingerprint(path: Path) -> str:
    """Hash of a file's content, or of its absence if it cannot be read (the reader reports that later)."""
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
    """A folder of artefacts; `fresh` computes everything again, and stores it."""

    folder: Path
    fresh: bool = False

    def path(self, artifact: Artifact, key: str) -> Path:
        """The file of an artefact."""
        return self.folder / artifact.kind / f"{key}.npz"

    def key(self, artifact: Artifact, inputs: Any) -> str:
        """Name of the artefact with these inputs."""
        return fingerprint(artifact, library_versions(), inputs)

    def cached(self, artifact: Artifact, inputs: Any, make: Callable[[], Arrays]) -> Arrays:
        """The arrays (...) of the artefact with these inputs; computed by `make` and stored if there is none."""
        key = self.key(artifact, inputs)
        found = self.load(artifact, key)
        if found is not None:
            return found
        made = make()
        self.save(artifact, key, made)
        return made

    def load(self, artifact: Artifact, key: str) -> dict[str, NDArray[Any]] | None:
        """The arrays (...) of an artefact by name, or None if it is to be computed."""
        path = self.path(artifact, key)
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
        with suppress(OSError):  # another user's, or read-only
            os.utime(path)  # the time of last use, for pruning
        with np.load(io.BytesIO(whole), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}

    def save(self, artifact: Artifact, key: str, arrays: Arrays) -> None:
        """Store an artefact; a failure to write is ignored, as only the next run takes longer."""
        try:
            packed = io.BytesIO()
            np.savez(packed, **cast("dict[str, Any]", arrays))
            with atomic_write(self.path(artifact, key), "wb") as file:
                file.write(packed.getbuffer())
                file.write(checksum(packed.getbuffer()))
        except MiniloopError:
            return
