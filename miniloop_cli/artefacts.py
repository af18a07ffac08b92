"""Finished work on disk: arrays named by a hash of what they were made from.

An artefact's name is a hash of its inputs, of the settings that matter to it and of the code's version, so that
nothing stale can be found, and a killed or repeated run finds what is done. Files are plain .npz, never unpickled;
one that cannot be read whole is deleted and made again.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miniloop_cli import __version__
from miniloop_cli.errors import MiniloopError
from miniloop_cli.files import atomic_write

Arrays = Mapping[str, NDArray[Any]]
MAKERS = ("scans", "features", "graph", "ransac", "solvers")  # packages whose code decides what an artefact holds


def default_folder() -> Path:
    """`$MINILOOP_CACHE`, else `$XDG_CACHE_HOME/miniloop`, else `~/.cache/miniloop`."""
    if os.environ.get("MINILOOP_CACHE"):
        return Path(os.environ["MINILOOP_CACHE"])
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "miniloop"


@cache
def code_version() -> str:
    """Hash of the release and of the sources that artefacts are made by: a changed solver finds no old result."""
    package = Path(__file__).parent
    digest = hashlib.blake2b(__version__.encode(), digest_size=16)
    for path in sorted(path for folder in MAKERS for path in (package / folder).rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def fingerprint(*parts: Any) -> str:
    """Hash of JSON-able parts and the code's version."""
    text = json.dumps([code_version(), *parts], sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def file_fingerprint(path: Path) -> str:
    """Hash of a file's content; of its absence where it cannot be read (the reader says why later)."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
    except OSError:
        return "unreadable"


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
        if self.fresh or not path.is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            os.utime(path)  # when it was last used: what pruning goes by
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zipfile.LargeZipFile):
            path.unlink(missing_ok=True)
            return None
        return arrays

    def save(self, kind: str, key: str, arrays: Arrays) -> None:
        """Keep an artefact; a store that cannot be written costs the next run time, never this run its result."""
        try:
            with atomic_write(self.path(kind, key), "wb") as file:
                np.savez(file, **arrays)
        except MiniloopError:
            return
