"""The one exception root of the project, caught once in the launcher."""

from __future__ import annotations

from collections.abc import Iterator


def printable(text: str, most: int) -> str:
    """Text on one line, with all characters printable; of a longer text the middle is left out."""
    text = text if len(text) <= most else f"{text[: most // 2 - 2]}...{text[-(most // 2 - 2) :]}"
    text = text.encode("utf-8", "backslashreplace").decode("utf-8")
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)


NO_MEMORY = ("Cannot allocate memory", "failed to map segment", "can't start new thread")


class MiniloopError(Exception):
    """An error that the user can act on: what is wrong, where, and what to do, in one line.

    The launcher prints the message and exits with status 1; a traceback is shown with `--debug` only. Messages quote
    foreign text, which is made printable here for all outputs.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message, 1500))


class InputError(MiniloopError):
    """A given file or folder cannot be used; the message names the file, and the line or frame."""


class ConfigError(MiniloopError):
    """A setting is unknown or out of range; the message names the key and its source."""


def causes(error: BaseException | None) -> Iterator[BaseException]:
    """The error, its cause, the cause of that, and so on."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def interrupted(error: BaseException | None) -> bool:
    """Whether an error comes from an interrupt, which compiled code and imports turn into other errors."""
    return any(isinstance(cause, KeyboardInterrupt) for cause in causes(error))


def out_of_memory(error: BaseException) -> bool:
    """Whether an error or its cause reports exhausted memory, in the words of any library."""
    return any(map(_says_out_of_memory, causes(error)))


def _says_out_of_memory(error: BaseException) -> bool:
    text = str(error)
    if type(error).__module__ == "cv2":
        return getattr(error, "code", 0) == -4 or "Insufficient memory" in text
    return isinstance(error, MemoryError) or any(words in text for words in NO_MEMORY)
