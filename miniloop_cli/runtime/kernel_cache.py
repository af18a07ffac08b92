"""The folder of compiled kernels, one for each version of the sources.

numba checks whether the file of a kernel has changed, but not the files of functions inlined into it. After an upgrade,
a kernel would use old code of its helpers. runtime.kernels uses this folder for the kernels of this package only, so
numba's own settings are unchanged.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

from miniloop_cli.errors import MiniloopError
from miniloop_cli.runtime.cache_folder import cache_folder

PACKAGE = Path(__file__).parents[1]
WORDS = b"njit", b"numba"  # every compiled source contains one of them
DAY_S = 86400.0


def kernels_folder(package: Path = PACKAGE) -> Path | None:
    """The folder for kernels compiled from the present sources; None if no place is writable.

    In `$NUMBA_CACHE_DIR` if it is set, else beside the sources, else in the user's cache. numba unpickles its files, so
    no other user may write to it. The folder may not exist yet.
    """
    place = next(filter(writable, _places(package)), None)
    return place and place / "kernels" / sources_hash(package)


def _places(package: Path) -> Iterator[Path]:
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(chosen)
        return
    yield package / "__pycache__"
    with suppress(MiniloopError):
        yield cache_folder()


def prepare_kernels_folder(package: Path = PACKAGE) -> None:
    """For the command line: remove kernels of earlier sources, and find a place for those of this run.

    If no place is writable, kernels are kept in a private folder during this process, so that a process that compiles
    them in advance can share them.
    """
    forget_old_kernels(package)
    if not any(map(writable, _places(package))):
        private = tempfile.mkdtemp(prefix="miniloop-")
        atexit.register(shutil.rmtree, private, ignore_errors=True)
        os.environ["NUMBA_CACHE_DIR"] = private


def forget_old_kernels(package: Path = PACKAGE) -> None:
    """Remove kernels of earlier sources beside the sources after a day, as older processes may still use them."""
    kept = package / "__pycache__" / "kernels"
    with suppress(OSError):  # there are none, permission is missing, or another process removes them
        folders = list(kept.iterdir())
        if len(folders) < 2:
            return
        for folder in folders:
            if folder.name != sources_hash(package) and time.time() - folder.stat().st_mtime > DAY_S:
                shutil.rmtree(folder, ignore_errors=True)


@cache
def sources_hash(package: Path) -> str:
    """Hash of the compiled sources at the first call."""
    sources = (path.read_bytes() for path in sorted(package.rglob("*.py")))
    return hashlib.sha256(b"".join(text for text in sources if any(word in text for word in WORDS))).hexdigest()[:16]


def writable(folder: Path) -> bool:
    """Whether the folder, or the nearest one above that exists, can be written."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK)
