"""What a first run waits for: `miniloop demo` without compiled kernels and with them, and the kernels by compile time.

    python benchmarks/cold_start.py [--json FILE] [COMMAND ...]

COMMAND, by default `demo`, is what follows `miniloop`; it runs twice in fresh processes and a folder of their own, the
first time with empty caches. Every process of it, those it starts included, reports each kernel that it compiles. A
kernel's seconds are CPU seconds of the compiling thread without those of the kernels it calls, which are listed
themselves.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

# Python runs a module of this name at the start of every process that finds it on its path.
RECORDER = '''
import atexit, json, os, time

from numba.core import event


class Recorder(event.Listener):
    """Appends a line for each kernel that was compiled, and the CPU seconds of the process so far."""

    def __init__(self):
        self.open = []

    def on_start(self, happened):
        self.open.append([time.thread_time(), 0.0])

    def on_end(self, happened):
        begin, inside = self.open.pop()
        seconds = time.thread_time() - begin
        if self.open:
            self.open[-1][1] += seconds
        kernel = happened.data["dispatcher"].py_func
        name = f"{kernel.__module__}.{kernel.__qualname__}"
        write({"kernel": name, "signature": str(happened.data["args"]), "seconds": seconds - inside})


def write(record):
    record |= {"process": os.getpid(), "process_seconds": time.process_time()}
    with open(os.environ["COLD_START_RECORDS"], "a") as file:
        file.write(json.dumps(record) + "\\n")


event.register("numba:compile", Recorder())
atexit.register(write, {"kernel": None})
'''


def timed(command: list[str], folder: Path, records: Path) -> dict[str, float]:
    """Run miniloop in `folder`; wall seconds, and CPU seconds of all its processes."""
    path = [str(folder / "recorder"), str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    # Python may write its own compiled files, as after any installation.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | {
        "PYTHONPATH": os.pathsep.join(filter(None, path)),
        "NUMBA_CACHE_DIR": str(folder / "kernels"),
        "MINILOOP_CACHE": str(folder / "cache"),
        "COLD_START_RECORDS": str(records),
    }
    begin, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "miniloop_cli", *command], cwd=folder, env=environment, check=True)
    wall_s, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    # A process that the run killed was not waited for: its last report counts.
    last: dict[int, dict[str, Any]] = {}
    for record in reported(records):
        last[record["process"]] = record
    cpu_s += sum(record["process_seconds"] for record in last.values() if record["kernel"])
    return {"wall_s": wall_s, "cpu_s": cpu_s}


def reported(records: Path) -> list[dict[str, Any]]:
    """What the processes reported: the kernels they compiled, and, without a kernel, that they came to their end."""
    return [json.loads(line) for line in records.read_text().splitlines()]


def table(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Kernels by compile time: CPU seconds, signatures, and how often one was compiled again in another process."""
    kernels: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for record in records:
        kernels[record["kernel"]].append(record)
    rows = [
        {
            "kernel": name.removeprefix("miniloop_cli."),
            "cpu_s": sum(record["seconds"] for record in found),
            "signatures": len({record["signature"] for record in found}),
            "compiled": len(found),
            "processes": len({record["process"] for record in found}),
        }
        for name, found in kernels.items()
    ]
    return sorted(rows, key=lambda row: -row["cpu_s"])


def main() -> None:
    """Measure, print, and write what was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="where to write the numbers as well")
    parser.add_argument("command", nargs=argparse.REMAINDER, help="what follows `miniloop` (default: demo)")
    given = parser.parse_args()
    command = given.command or ["demo", "--quiet"]
    with tempfile.TemporaryDirectory(prefix="cold-start-") as name:
        folder = Path(name)
        (folder / "recorder").mkdir()
        (folder / "recorder" / "sitecustomize.py").write_text(RECORDER)
        cold = timed(command, folder, folder / "cold.jsonl")
        records = [record for record in reported(folder / "cold.jsonl") if record["kernel"]]
        # The kernels stay, the stages' results do not: the same work once more.
        (folder / "cache").rename(folder / "old_cache")
        warm = timed(command, folder, folder / "warm.jsonl")
        again = sum(record["kernel"] is not None for record in reported(folder / "warm.jsonl"))
    rows = table(records)
    print(f"{'CPU s':>7} {'signatures':>10} {'compiled':>8} {'processes':>9}  kernel")
    for row in rows:
        print(f"{row['cpu_s']:7.2f} {row['signatures']:10} {row['compiled']:8} {row['processes']:9}  {row['kernel']}")
    total_s = sum(row["cpu_s"] for row in rows)
    print(f"{total_s:7.2f} {sum(row['signatures'] for row in rows):10} {len(records):8}  {len(rows)} kernels")
    print(f"miniloop {' '.join(command)}")
    print(f"  without compiled kernels {cold['wall_s']:.1f} s, {cold['cpu_s']:.1f} CPU s")
    print(f"  with them                {warm['wall_s']:.1f} s, {warm['cpu_s']:.1f} CPU s; {again} kernels compiled")
    if given.json:
        given.json.write_text(json.dumps({"cold": cold, "warm": warm, "compile_cpu_s": total_s, "kernels": rows}))


if __name__ == "__main__":
    main()
