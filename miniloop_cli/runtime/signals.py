"""Ctrl-C and SIGTERM, wherever they arrive, as KeyboardInterrupt in the main thread."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType

from miniloop_cli.errors import interrupted

Handler = Callable[[int, FrameType | None], None]

INTERRUPTS = signal.SIGINT, signal.SIGTERM
AGAIN_S = 0.5
UNINTERRUPTIBLE = (  # library and function
    ("llvmlite", "close"),  # gives memory back and then notes it: in between, it does so twice
    ("numba", "load_overload"),  # links a kernel into the process: half of it crashes when it is taken apart
)
HAS_ALARM = hasattr(signal, "setitimer")  # not so on Windows


@contextmanager
def heeded_interrupts() -> Iterator[None]:
    """SIGTERM as Ctrl-C inside this block: a stopped container tidies up, too. For the main thread of a command.

    Where libraries catch everything, or compiled code calls Python, an interrupt is lost and the command would go on.
    So each comes again every AGAIN_S until the block ends, unless it is just being dealt with; not on Windows, which
    has no alarm. Handlers and `sys.unraisablehook` are left as they were found.
    """
    handlers: dict[signal.Signals, Handler] = {
        number: _interrupt
        for number in INTERRUPTS
        if signal.getsignal(number) is not signal.SIG_IGN  # as in the background of a shell script
    }
    if HAS_ALARM:
        handlers[signal.SIGALRM] = _again
    hook = sys.unraisablehook
    with _handled(handlers):
        sys.unraisablehook = _forgotten
        try:
            yield
        finally:
            sys.unraisablehook = hook
            _repeat_every(0)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Interrupts wait until the block has ended; for what can be neither stopped half-way nor done again."""
    if threading.current_thread() is not threading.main_thread():  # no interrupt arrives in any other
        yield
        return
    came: list[int] = []
    try:
        with _handled({number: lambda number, _: came.append(number) for number in INTERRUPTS}):
            yield
    finally:
        for number in came[:1]:  # also where the block failed: whoever interrupts wants no other error
            signal.raise_signal(number)


@contextmanager
def _handled(handlers: Mapping[signal.Signals, Handler]) -> Iterator[None]:
    """Handlers of signals inside the block, and afterwards those that were found."""
    found = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in found.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: not Python's own


def _repeat_every(seconds: float) -> None:
    """Let the alarm go off every so often; 0 stops it."""
    if HAS_ALARM:
        signal.setitimer(signal.ITIMER_REAL, seconds, seconds)


def _interrupt(_: int, frame: FrameType | None) -> None:
    _repeat_every(AGAIN_S)
    if HAS_ALARM and _is_uninterruptible(frame):
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
    if not issubclass(unraisable.exc_type, KeyboardInterrupt) or not HAS_ALARM:
        sys.__unraisablehook__(unraisable)
