"""YAML of unknown origin: the safe loader only, one kind of error, bounded size and depth."""

from __future__ import annotations

from typing import Any

MOST_BRACKETS = 200  # the time grows with the square of the depth; cameras and settings are flat


def load_plain(text: str, loader: type | None = None) -> Any:
    """The content of a YAML text; `loader` is a subclass of yaml.SafeLoader.

    Raises yaml.YAMLError, and nothing else, for other texts and for deep nesting.
    """
    import yaml

    if text.count("[") + text.count("{") > MOST_BRACKETS:
        raise yaml.YAMLError(f"more than {MOST_BRACKETS} brackets")
    try:
        return yaml.load(text, loader or yaml.SafeLoader)
    except (ValueError, TypeError, AttributeError, KeyError, ArithmeticError, RecursionError) as error:
        raise yaml.YAMLError(type(error).__name__) from error
