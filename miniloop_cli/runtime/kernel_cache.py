"""Where compiled kernels are kept: in a folder of their own for each state of the sources.

numba looks whether the file of a kernel has changed, not the files of what is inlined into it: after an upgrade, a
kernel would go on with the old code of its helpers.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import tempfile
import time
from contextlib import suppress
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
DAY_S = 86400.0


def keep_compiled() -> None:
    """Name the folder for numba, where the user has not; called before numba is imported.

    Beside the sources, else in the user's cache or `$MINILOOP_CACHE`, else, for a read-only installation that is run by
    a user without a home, a private one that lasts as long as this process: numba unpickles what lies there, so nobody
    else may write to it.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        return
    beside, own = PACKAGE / "__pycache__", os.environ.get("MINILOOP_CACHE")
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))  # noqa: PTH111 (may be unknown)
    places = [beside, home / "miniloop", *([Path(own)] if own else [])]
    place = next(filter(writable, places), None)
    if place is None:
        place = Path(tempfile.mkdtemp(prefix="miniloop-"))
        atexit.register(shutil.rmtree, place, ignore_errors=True)
    folder = place / "kernels" / sources_hash(PACKAGE)
    if place == beside and not folder.exists():
        _forget_old(folder.parent)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)


def _forget_old(folder: Path) -> None:
    """Remove what belongs to earlier sources; a process that began with them may still be at work for a day."""
    with suppress(OSError):  # another process may do the same
        for old in folder.iterdir():
            if time.time() - old.stat().st_mtime > DAY_S:
                shutil.rmtree(old, ignore_errors=True)


def sources_hash(package: Path) -> str:
    """Hash of the sources that are compiled."""
    sources = (path.read_bytes() for path in sorted(package.rglob("*.py")))
    return hashlib.sha256(b"".join(source for source in sources if b"numba" in source)).hexdigest()[:16]


def writable(folder: Path) -> bool:
    """Whether the folder, or the nearest one above that exists, can be written."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK)
