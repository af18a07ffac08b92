"""Every kind of feature on real sequences: `MINILOOP_TUM=... python benchmarks/features.py [FRAMES]`; a Markdown table.

Absolute error after SE(3) alignment; relative errors over the fixed lists of pairs in benchmarks/edges; seconds of the
processor, warm, so that other work on the machine does not count.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

from miniloop_cli.api import evaluate, register
from miniloop_cli.scene.edge import VERIFIED

KINDS = ("rootsift", "sift", "orb", "surf", "akaze", "brisk")
NAMES = ("freiburg1_xyz_100", "freiburg1_desk_100")


def row(recording: Path, kind: str, frames: int | None, folder: Path) -> str:
    begin = time.process_time()
    run = register(recording, folder, overrides=(f"features.type={kind}",), max_frames=frames)
    took_s = time.process_time() - begin
    pairs = Path(__file__).with_name("edges") / f"{recording.name}.txt"
    numbers = evaluate(folder, recording, edges=pairs if frames is None else None).numbers
    edges = numbers["rpe"]["edges"]
    verified = sum(edge.verdict == VERIFIED for edge in run.edges)
    return (
        f"| {recording.name} | {kind} | {len(run.poses.registered)} of {len(run.scans)} | {verified} "
        f"| {100 * numbers['ate_rmse_m']:.2f} cm | {edges['rot_deg_mean']:.2f}° / {100 * edges['trans_m_mean']:.2f} cm "
        f"| {took_s:.0f} s |"
    )


if __name__ == "__main__":
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else None
    print("| sequence | features | frames | edges | ATE | relative | CPU |\n|---|---|---|---|---|---|---|")
    for name in NAMES:
        for kind in KINDS:
            with tempfile.TemporaryDirectory() as folder:
                os.environ["MINILOOP_CACHE"] = f"{folder}/cache"
                print(row(Path(os.environ["MINILOOP_TUM"]) / name, kind, frames, Path(folder) / "out"), flush=True)
