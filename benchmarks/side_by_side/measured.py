"""A command measured as a whole: `python measured.py OUT COMMAND...`.

Run as a program of its own where the caller is large: the memory of a process counts in that of its children, since
these begin as its copies. Imports nothing for that reason.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]


def measure(out: Path, command: list[str]) -> None:
    """Run it; its seconds and largest resident memory go to <out>.usage.json, what it says to <out>.log.

    Those of the processes that it starts and waits for are included.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    for suffix in (".json", ".txt", ".usage.json"):
        out.with_suffix(suffix).unlink(missing_ok=True)
    # Threads that wait for each other shall sleep, not spin: spinning would be counted as work.
    environment = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE", "PYTHONPATH": str(ROOT)}
    load, begin = os.getloadavg()[0], time.perf_counter()
    with out.with_suffix(".log").open("w", encoding="utf-8") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    peak = usage.ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)
    numbers = {"wall": time.perf_counter() - begin, "cpu": usage.ru_utime + usage.ru_stime, "peak_mb": peak}
    numbers |= {"load_before": load, "status": process.returncode}
    out.with_suffix(".usage.json").write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    done = "done" if process.returncode == 0 else f"FAILED, see {out.with_suffix('.log')}"
    print(f"{out}: {done}, {numbers['wall']:.0f} s, CPU {numbers['cpu']:.0f} s", file=sys.stderr, flush=True)


if __name__ == "__main__":
    measure(Path(sys.argv[1]), sys.argv[2:])
