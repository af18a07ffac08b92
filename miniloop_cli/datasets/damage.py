"""Damaged data: any error of a library that decodes them becomes one line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from miniloop_cli.errors import InputError, out_of_memory


@contextmanager
def damage(words: str | Callable[[Exception], str]) -> Iterator[None]:
    """Any error inside is an InputError in these `words`, which may depend on the error.

    An InputError keeps its own, and running out of memory is no damage.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        if out_of_memory(error):
            raise
        raise InputError(words if isinstance(words, str) else words(error)) from error
