"""A map while the processes that change it are killed: it is as it was or finished, and going on works."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from miniloop_cli.errors import MiniloopError
from miniloop_cli.results.map_files import up_to_date
from miniloop_cli.results.map_folder import FOLDER, manifest_hash, read_map

CLOSE_S = 0.5  # after the first file of the new map is there: half of the kills come within this time
SIGNALS = signal.SIGKILL, signal.SIGTERM


@dataclass(frozen=True)
class Ended:
    """How a killed `add` left the map: whether it is the old or the new one, and whether it is read whole."""

    how: str
    changed: bool
    files_left: bool  # files beside the map were not written any more
    seconds: float
    reads: int  # of the map by another process meanwhile


def adding(folder: Path, sequence: Path) -> subprocess.Popen[str]:
    """A process that runs `miniloop add`, and what it says."""
    line = [sys.executable, "-m", "miniloop_cli", "add", str(folder), str(sequence), "-q", "-j", "1"]
    return subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def added(folder: Path, sequence: Path) -> str:
    """The output of an `add` that is not interrupted."""
    return adding(folder, sequence).communicate()[1].strip()


def killed_once(folder: Path, sequence: Path, after: str, sent: signal.Signals, wait_s: float, near_end: bool) -> Ended:
    """One `add` killed `wait_s` after its start, or after it began to write the new map; checked against `after`.

    Meanwhile the map is read again and again. Raises MiniloopError where the map is neither what it was nor `after`.
    """
    before, names = manifest_hash(folder), set((folder / FOLDER).iterdir())
    process = adding(folder, sequence)
    begin, due, reads = time.perf_counter(), np.inf if near_end else wait_s, 0
    while process.poll() is None and time.perf_counter() - begin < due:
        if near_end and due == np.inf and set((folder / FOLDER).iterdir()) - names:
            due = time.perf_counter() - begin + wait_s
        if near_end and due < np.inf:
            time.sleep(0.001)
            continue
        read_map(folder)  # raises for half a map
        reads += 1
        time.sleep(0.02)
    how = "ended by itself" if process.poll() is not None else sent.name
    process.send_signal(sent)
    process.communicate()
    seconds, now = time.perf_counter() - begin, manifest_hash(folder)
    read_map(folder)
    if now not in (before, after):
        raise MiniloopError(
            f"{folder}: {sent.name} after {seconds:.2f} s left a map that is neither the old nor the new one"
        )
    return Ended(how, now != before, not up_to_date(folder), seconds, reads)


def show_kills(folder: Path, sequence: Path, count: int, seed: int = 0) -> None:
    """So many kills of `miniloop add` to copies of the map; then two processes at once."""
    rng, said = np.random.default_rng(seed), Counter[str]()
    with _copied(folder) as copy:
        added(copy, sequence)
        after = manifest_hash(copy)
    with _copied(folder) as copy:  # now that all is compiled and kept
        begin = time.perf_counter()
        added(copy, sequence)
        seconds = time.perf_counter() - begin
    for k in range(count):
        with _copied(folder) as copy:
            near_end = bool(k % 2)
            wait_s = float(rng.uniform(0, CLOSE_S if near_end else seconds))
            left = killed_once(copy, sequence, after, SIGNALS[k // 2 % 2], wait_s, near_end)
            again = added(copy, sequence)
            if ("is in the map already" in again) != left.changed:
                raise MiniloopError(f"after {left}, adding again said: {again}")
            if manifest_hash(copy) != after or not up_to_date(copy):
                raise MiniloopError(f"after {left}, adding again left {copy} unfinished: {again}")
            state = "finished" if left.changed else "as it was"
            files = ", files beside it written by the next command" if left.changed and left.files_left else ""
            said[f"{left.how}: the map is {state}{files}"] += 1
            said["reads meanwhile, all whole"] += left.reads
            print(f"{k + 1} of {count}: {left}", file=sys.stderr, flush=True)
    print(f"add takes {seconds:.1f} s; {count} were killed, and went on when they were called again")
    for line, times in sorted(said.items()):
        print(f"{times:5d} {line}")
    with _copied(folder) as copy:
        both = [adding(copy, sequence) for _ in range(2)]
        print("two at once:", " / ".join(process.communicate()[1].strip() or "added" for process in both))
        if manifest_hash(copy) != after:
            raise MiniloopError(f"two processes at {copy} left a map that neither wrote")


@contextmanager
def _copied(folder: Path) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as temporary:
        yield Path(shutil.copytree(folder, Path(temporary) / folder.name))
