"""miniloop: poses and one consistent model from RGB-D scans.

    from miniloop_cli import evaluate, register, simulate

The calls of miniloop_cli.api are imported on first use, so that the command line starts fast. Importing this package
does not change the process or any file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from miniloop_cli.version import __version__

if TYPE_CHECKING:
    from miniloop_cli.api import evaluate, register, simulate
    from miniloop_cli.results.map import Map

__all__ = ["Map", "__version__", "evaluate", "register", "simulate"]


def __getattr__(name: str) -> Any:
    if name == "Map":
        from miniloop_cli.results.map import Map

        return Map
    if name in __all__:
        from miniloop_cli import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
