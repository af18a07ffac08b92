"""Damaged input is read, or refused in one line."""

from miniloop_cli.errors import MiniloopError


def one_line(error: MiniloopError) -> None:
    text = str(error)
    assert text and text.isprintable() and len(text) < 2000
    text.encode("utf-8")


def attempt(action, *arguments):
    """What the action gives; None where it refuses, in one line."""
    try:
        return action(*arguments)
    except MiniloopError as error:
        one_line(error)
        return None
