"""The user's cache folder, for finished work and, if necessary, compiled kernels."""

from __future__ import annotations

import os
from pathlib import Path

from miniloop_cli.errors import MiniloopError


def cache_folder() -> Path:
    """`$MINILOOP_CACHE`, else the system's place: `$XDG_CACHE_HOME/miniloop` or `~/.cache/miniloop` on Linux.

    The folder may not exist yet. Raises MiniloopError if the user has no home folder.
    """
    if own := os.environ.get("MINILOOP_CACHE"):
        return Path(own)
    from platformdirs import user_cache_path

    try:
        folder = user_cache_path("miniloop", appauthor=False)
    except RuntimeError:
        folder = Path("~")
    if not folder.is_absolute():  # some versions of platformdirs keep the "~" instead of raising
        raise MiniloopError("this user has no home folder to keep finished work in: set MINILOOP_CACHE")
    return folder
