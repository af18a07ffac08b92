"""Ctrl-C and SIGTERM as KeyboardInterrupt in the main thread."""

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
    ("llvmlite", "close"),  # frees memory before recording it: an interrupt between both frees it twice
    ("numba", "load_overload"),  # links a kernel into the process: a partly linked one crashes when it is removed
)
HAS_ALARM = hasattr(signal, "setitimer")  # not on Windows


@contextmanager
def heeded_interrupts() -> Iterator[None]:
    """SIGTERM acts as Ctrl-C inside this block, so that a stopped container also cleans up. For the main thread.

    Libraries that catch everything, and compiled code that calls Python, can lose an interrupt. Each one is therefore
    repeated every AGAIN_S until the block ends, unless it is being handled; not on Windows, which has no alarm.
    Handlers and `sys.unraisablehook` are restored.
    """
    handlers: dict[signal.Signals, Handler] = {
        number: _interrupt
        for number in INTERRUPTS
        if signal.getsignal(number) is not signal.SIG_IGN  # ignored, as for background jobs of a shell script
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
    """Interrupts wait until the block has ended; for work that can be neither stopped half-way nor repeated."""
    if threading.current_thread() is not threading.main_thread():  # interrupts arrive in the main thread only
        yield
        return
    came: list[int] = []
    try:
        with _handled({number: lambda number, _: came.append(number) for number in INTERRUPTS}):
            yield
    finally:
        for number in came[:1]:  # also if the block failed: the interrupt has precedence
            signal.raise_signal(number)


@contextmanager
def _handled(handlers: Mapping[signal.Signals, Handler]) -> Iterator[None]:
    """Set handlers of signals inside the block, and restore the earlier ones afterwards."""
    found = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in found.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: not Python's own


def _repeat_every(seconds: float) -> None:
    """Let the alarm go off every `seconds`; 0 stops it."""
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
    """Whether a library runs a function that must not be interrupted; the interrupt is repeated a little later."""
    while frame:
        if any(
            name == frame.f_code.co_name and library in frame.f_code.co_filename for library, name in UNINTERRUPTIBLE
        ):
            return True
        frame = frame.f_back
    return False


def _forgotten(unraisable: sys.UnraisableHookArgs) -> None:
    """Python prints errors in callbacks of a library and drops them; an interrupt is repeated instead."""
    if not issubclass(unraisable.exc_type, KeyboardInterrupt) or not HAS_ALARM:
        sys.__unraisablehook__(unraisable)
