"""Where compiled kernels are kept: numba finds a place by itself, except where nothing it thinks of can be written."""

from __future__ import annotations

import os
from pathlib import Path


def keep_compiled() -> None:
    """Name a folder for numba where it would refuse to load: a read-only installation run by a user without a home.

    `$MINILOOP_CACHE/kernels`, else a private temporary folder that lasts as long as this process: numba unpickles
    what lies there, so nobody else may write to it. Called before numba is imported.
    """
    package = Path(__file__).parent
    beside = package / "__pycache__"
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))  # noqa: PTH111 (may be unknown)
    if os.environ.get("NUMBA_CACHE_DIR") or any(map(writable, (beside if beside.exists() else package, home))):
        return
    own = os.environ.get("MINILOOP_CACHE")
    if own and writable(Path(own)):
        os.environ["NUMBA_CACHE_DIR"] = str(Path(own) / "kernels")
        return
    import atexit
    import shutil
    import tempfile

    os.environ["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(prefix="miniloop-kernels-")
    atexit.register(shutil.rmtree, os.environ["NUMBA_CACHE_DIR"], ignore_errors=True)


def writable(folder: Path) -> bool:
    """Whether the folder, or the nearest one above that exists, can be written."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK)
