"""Damaged data: errors of decoding libraries become one-line messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from miniloop_cli.errors import InputError, out_of_memory


@contextmanager
def damage(words: str | Callable[[Exception], str]) -> Iterator[None]:
    """Raise any error inside as an InputError with these `words`, which may depend on the error.

    An InputError keeps its message, and running out of memory is not damage.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        if out_of_memory(error):
            raise
        raise InputError(words if isinstance(words, str) else words(error)) from error
