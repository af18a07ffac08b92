"""Wheels that only some recordings need: imported when such a recording is read, with a hint if they are missing."""

from __future__ import annotations

import importlib
from typing import Any

from miniloop_cli.errors import InputError


def optional_wheel(module: str, wheel: str, extra: str) -> Any:
    """The module of an optional wheel. Raises InputError (reason only) with the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        if isinstance(error, ModuleNotFoundError) and error.name in (module, module.partition(".")[0]):
            raise InputError(f"the wheel {wheel} is needed: pip install 'miniloop[{extra}]'") from error
        raise InputError(f"the wheel {wheel} cannot be loaded ({error}): reinstall 'miniloop[{extra}]'") from error
