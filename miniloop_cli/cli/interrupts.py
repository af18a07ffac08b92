"""Ctrl-C and SIGTERM, wherever they arrive, as KeyboardInterrupt in the main thread."""

from __future__ import annotations

import signal
import sys

AGAIN_S = 0.05


def heed_interrupts() -> None:
    """SIGTERM as Ctrl-C: a stopped container tidies up, too. Called from the main thread."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.unraisablehook = _come_again


def _come_again(unraisable: sys.UnraisableHookArgs) -> None:
    """An error in a callback of a library is printed by Python and forgotten; an interrupt comes again instead."""
    if not issubclass(unraisable.exc_type, KeyboardInterrupt) or not hasattr(signal, "setitimer"):
        sys.__unraisablehook__(unraisable)
        return
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
