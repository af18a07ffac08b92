"""A small recording in TUM layout and the results folder of a run over it, with hostile names in both."""

import csv
import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.intrinsics import save_camera
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import radial_tangential_lens
from miniloop_cli.results.ply import write_ply
from miniloop_cli.scene.sequence import Trajectory

EVIL = '"><script>document.title="owned"</script>'
FRAMES = 8


def write_rows(path, rows):
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


@pytest.fixture
def run(tmp_path):
    rng = np.random.default_rng(0)
    sequence = tmp_path / "a room <b>bold"
    for kind in ("rgb", "depth"):
        (sequence / kind).mkdir(parents=True)
    save_camera(
        sequence / "camera.yaml", Camera(100, 100, 79.5, 59.5, 160, 120, lens=radial_tangential_lens(0.1, 0, 0, 0, 0))
    )
    stamps = 100 + np.arange(FRAMES) / 10
    T = se3.pose(se3.exp_so3(rng.normal(scale=0.1, size=(FRAMES, 3))), np.cumsum(rng.normal(size=(FRAMES, 3)), axis=0))
    for stamp in stamps:
        cv2.imwrite(str(sequence / "rgb" / f"{stamp:.6f}.png"), rng.integers(0, 256, (120, 160, 3), dtype=np.uint8))
        cv2.imwrite(str(sequence / "depth" / f"{stamp:.6f}.png"), np.full((120, 160), 5000, np.uint16))
    write_trajectory(sequence / "groundtruth.txt", Trajectory(stamps, T))
    results = tmp_path / "results"
    results.mkdir()
    kept = np.arange(FRAMES) != 5
    write_trajectory(results / "trajectory.txt", Trajectory(stamps[kept], T[kept]))
    edges = []
    for i in range(FRAMES):
        for j in range(i + 1, min(i + 3, FRAMES)):
            lost = 5 in (i, j)
            row = {
                "i": i,
                "j": j,
                "timestamp_i": stamps[i],
                "timestamp_j": stamps[j],
                "matches": 30 + i,
                "inliers": 20 - j,
            }
            row |= {"solver": ["cycle5", "pairwise", EVIL][(i + j) % 3], "cycle": 1}
            row |= {"verdict": "rejected" if lost else "verified", "rejection": "no_hypothesis" if lost else ""}
            row |= {"reason": EVIL if lost else ""}
            row |= {"rot_residual_deg": "" if lost else 0.1 * (i + 1), "trans_residual_m": "" if lost else 0.01 * j}
            edges.append(row)
    write_rows(results / "edges.csv", edges)
    frames = [
        {"index": k, "timestamp": stamps[k], "keypoints": 500, "with_depth": 400, "depth_valid_share": 0.8,
         "median_depth_m": 1.0, "registered": int(kept[k]), "component": 0 if kept[k] else -1,
         "status": "registered" if kept[k] else "no_matches", "reason": "" if kept[k] else f"no match {EVIL}"}
        for k in range(FRAMES)
    ]  # fmt: skip
    write_rows(results / "frames.csv", frames)
    offsets = 3 * np.arange(len(edges) + 1)
    px = rng.uniform(5, 110, (3 * len(edges), 2))
    np.savez(results / "inliers.npz", offsets=offsets, px_i=px, px_j=px)
    write_ply(results / "cloud.ply", rng.normal(size=(2000, 3)), rng.integers(0, 256, (2000, 3), dtype=np.uint8))
    summary = {
        "frames": FRAMES,
        "registered": 7,
        "timings_s": {"features": 1.5, EVIL: 0.5},
        "versions": {"numpy": EVIL},
    }
    (results / "summary.json").write_text(json.dumps(summary | {EVIL: [EVIL]}))
    (results / "config.yaml").write_text(f"a: '{EVIL}'\n")
    (results / "log.txt").write_text("took a camera\n" * 10_000)
    return SimpleNamespace(results=results, sequence=open_sequence(sequence), edges=edges)
