"""Ctrl-C and SIGTERM, wherever they arrive, as KeyboardInterrupt in the main thread."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from miniloop_cli.errors import interrupted

INTERRUPTS = signal.SIGINT, signal.SIGTERM
AGAIN_S = 0.5
UNINTERRUPTIBLE = (  # library and function
    ("llvmlite", "close"),  # gives memory back and then notes it: in between, it does so twice
    ("numba", "load_overload"),  # links a kernel into the process: half of it crashes when it is taken apart
)
COME_AGAIN = hasattr(signal, "setitimer")  # not so on Windows


def install_handlers() -> None:
    """SIGTERM as Ctrl-C: a stopped container tidies up, too. Called from the main thread.

    Where libraries catch everything, or compiled code calls Python, an interrupt is lost and the command would go on.
    So each comes again every AGAIN_S, unless it is just being dealt with, until `stop_repeating`.
    """
    for number in INTERRUPTS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as in the background of a shell script
            signal.signal(number, _interrupt)
    if COME_AGAIN:
        signal.signal(signal.SIGALRM, _again)
    sys.unraisablehook = _forgotten


def stop_repeating() -> None:
    """No interrupt comes again."""
    if COME_AGAIN:
        signal.setitimer(signal.ITIMER_REAL, 0)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Interrupts wait until the block has ended; for what can be neither stopped half-way nor done again."""
    if threading.current_thread() is not threading.main_thread():  # no interrupt arrives in any other
        yield
        return
    came: list[int] = []
    before = {number: signal.signal(number, lambda number, _: came.append(number)) for number in INTERRUPTS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in came[:1]:  # also where the block failed: whoever interrupts wants no other error
            signal.raise_signal(number)


def _interrupt(_: int, frame: FrameType | None) -> None:
    if COME_AGAIN:
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S, AGAIN_S)
        if _is_uninterruptible(frame):
            return
    raise KeyboardInterrupt


def _again(_: int, frame: FrameType | None) -> None:
    if not interrupted(sys.exception()) and not _is_uninterruptible(frame):
        raise KeyboardInterrupt


def _is_uninterruptible(frame: FrameType | None) -> bool:
    """Whether a library is at what it does not survive to be cut off in; the interrupt comes again a little later."""
    while frame:
        if any(
            name == frame.f_code.co_name and library in frame.f_code.co_filename for library, name in UNINTERRUPTIBLE
        ):
            return True
        frame = frame.f_back
    return False


def _forgotten(unraisable: sys.UnraisableHookArgs) -> None:
    """An error in a callback of a library is printed by Python and forgotten; an interrupt comes again instead."""
    if not issubclass(unraisable.exc_type, KeyboardInterrupt) or not COME_AGAIN:
        sys.__unraisablehook__(unraisable)
