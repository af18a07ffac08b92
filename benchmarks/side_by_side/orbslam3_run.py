"""ORB-SLAM3's RGB-D mode (wheel pyorbslam3) over a list of frames: `LIST OUT --vocabulary FILE --settings FILE`.

LIST has a line `stamp colour depth` a frame. Light on purpose: what this process takes is what ORB-SLAM3 takes.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import threading
import time
from pathlib import Path

import cv2
import numpy as np

POLL_S, QUIET_POLLS, LONGEST_WAIT_S = 0.004, 3, 10.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("list", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--vocabulary", required=True)
    parser.add_argument("--settings", required=True)
    parser.add_argument("--hz", type=float, default=20.0, help="frames a second at most")
    parser.add_argument("--keep-up", action="store_true", help="a frame waits until mapping rests")
    given = parser.parse_args()
    import pyorbslam3

    cv2.setNumThreads(1)
    frames = [line.split("\t") for line in given.list.read_text(encoding="utf-8").splitlines()]
    slam = pyorbslam3.Slam(given.vocabulary, given.settings, pyorbslam3.Sensor.RGBD, False)
    started, states, waits = _cpu_s(), dict[str, int](), list[tuple[float, float]]()
    due = time.perf_counter()
    for stamp, color, depth in frames:
        image = cv2.cvtColor(cv2.imread(color, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
        stored = cv2.imread(depth, cv2.IMREAD_UNCHANGED).astype(np.float32)
        time.sleep(max(due - time.perf_counter(), 0))
        if given.keep_up:
            waits.append(_wait_for_rest())
        due = time.perf_counter() + 1 / given.hz
        state = str(slam.track_rgbd(image, stored, float(stamp)).state).rpartition(".")[2]
        states[state] = states.get(state, 0) + 1
    waits.append(_wait_for_rest())
    slam.shutdown()
    saved = given.out.with_suffix(".saved.txt")
    slam.save_trajectory_tum(str(saved))
    rows = tracked(saved.read_text(encoding="utf-8").splitlines())
    given.out.with_suffix(".txt").write_text("".join(f"{row}\n" for row in rows), encoding="utf-8")
    numbers = {"frames": len(frames), "states": states, "start_cpu_s": started, "cpu_s": _cpu_s() - started}
    numbers["not_rested"] = sum(wait >= LONGEST_WAIT_S for wait, _ in waits)
    numbers["watching_cpu_s"] = sum(cpu_s for _, cpu_s in waits)
    given.out.with_suffix(".json").write_text(json.dumps(numbers) + "\n", encoding="utf-8")
    os._exit(0)  # its threads and destructors do not always come to an end


def tracked(rows: list[str]) -> list[str]:
    """The rows of a saved trajectory that are poses: of a frame that was lost, stamp and pose before it come again."""
    stamps = [row.partition(" ")[0] for row in rows]
    return [row for k, row in enumerate(rows) if k == 0 or stamps[k] != stamps[k - 1]]


def _cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def _wait_for_rest() -> tuple[float, float]:
    """Until no other thread of this process wants a core at several looks in a row; the seconds and CPU seconds of it.

    Threads that wait for work look for it every few ms: each is asleep at nearly any moment.
    """
    begin, cpu_s, quiet = time.perf_counter(), time.thread_time(), 0
    while quiet < QUIET_POLLS and time.perf_counter() - begin < LONGEST_WAIT_S:
        time.sleep(POLL_S)
        quiet = 0 if _others_run() else quiet + 1
    return time.perf_counter() - begin, time.thread_time() - cpu_s


def _others_run() -> bool:
    me = str(threading.get_native_id())
    for task in Path("/proc/self/task").iterdir():
        try:
            state = (task / "stat").read_text().rpartition(")")[2].split()[0]
        except OSError:  # it has ended
            continue
        if task.name != me and state in "RD":
            return True
    return False


if __name__ == "__main__":
    main()
