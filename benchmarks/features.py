"""Every kind of feature on real recordings; a Markdown table.

Absolute error after SE(3) alignment; relative errors over the fixed lists of pairs in benchmarks/edges; seconds of the
processor, warm, so that other work on the machine does not count.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from benchmarks.side_by_side.sections import edge_list
from miniloop_cli.api import evaluate, register

KINDS = ("rootsift", "sift", "orb", "surf", "akaze", "brisk")


def row(recording: Path, kind: str, frames: int | None, folder: Path) -> str:
    begin = time.process_time()
    run = register(recording, folder, overrides=(f"features.type={kind}",), max_frames=frames)
    took_s = time.process_time() - begin
    pairs = edge_list(recording)
    numbers = evaluate(folder, recording, edges=pairs if frames is None and pairs.is_file() else None).numbers
    edges = numbers["rpe"]["edges"]
    return (
        f"| {recording.name} | {kind} | {len(run.poses.registered)} of {len(run.scans)} | {run.edges.verified.sum()} "
        f"| {100 * numbers['ate_rmse_m']:.2f} cm | {edges['rot_deg_mean']:.2f}° / {100 * edges['trans_m_mean']:.2f} cm "
        f"| {took_s:.0f} s |"
    )


def show(recordings: Iterable[Path], frames: int | None) -> None:
    """Print a row a recording and kind, at most so many `frames` each."""
    print("| sequence | features | frames | edges | ATE | relative | CPU |\n|---|---|---|---|---|---|---|")
    for recording in recordings:
        for kind in KINDS:
            with tempfile.TemporaryDirectory() as folder:
                os.environ["MINILOOP_CACHE"] = f"{folder}/cache"
                print(row(recording, kind, frames, Path(folder) / "out"), flush=True)
