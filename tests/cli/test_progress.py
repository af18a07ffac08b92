"""Progress: a bar on a terminal, nothing in a pipe or with -q, and then nothing loaded for it either."""

import os
import subprocess
import sys

import pytest

COUNTING = """
import sys
from miniloop_cli.runtime.progress import track
print(sum(track(range(30), "counting", 30, quiet="-q" in sys.argv)), "rich" in sys.modules)
"""


def _run(on_terminal: bool, *arguments: str) -> tuple[str, str]:
    """What the count says, and what stderr shows."""
    reading, writing = pytest.importorskip("pty").openpty() if on_terminal else os.pipe()
    command = [sys.executable, "-c", COUNTING, *arguments]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=writing, text=True, check=True, timeout=120)
    os.set_blocking(reading, False)
    try:
        shown = os.read(reading, 1 << 20).decode()
    except BlockingIOError:
        shown = ""
    finally:
        os.close(reading)
        os.close(writing)
    return done.stdout.strip(), shown


def test_a_terminal_shows_a_bar():
    said, shown = _run(True)
    assert said == "435 True"
    assert "counting" in shown
    assert "30/30" in shown


@pytest.mark.parametrize(("on_terminal", "arguments"), [(False, ()), (True, ("-q",)), (False, ("-q",))])
def test_otherwise_nothing_is_shown(on_terminal, arguments):
    assert _run(on_terminal, *arguments) == ("435 False", "")
