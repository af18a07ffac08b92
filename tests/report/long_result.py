"""The results folder of a long recording, made without registering one: a hand-held tour through a flat of rooms."""

import json
from pathlib import Path

import cv2
import numpy as np

from miniloop_cli.datasets.intrinsics import save_camera
from miniloop_cli.datasets.thumbnails import thumbnail
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.results.ply import write_ply
from miniloop_cli.results.tables import EDGE_COLUMNS, FRAME_COLUMNS, write_csv
from miniloop_cli.results.thumbnails import write_thumbnails
from miniloop_cli.scene.sequence import Trajectory

RATE_HZ, KEYFRAME_EVERY = 30.0, 8
ROOM_M, HEIGHT_M = 5.0, 2.6


def write_long_result(folder, frames=10_000, points=2_000_000, seed=0):
    """A result of so many frames and points; an eighth of the frames are keyframes, with 20 edges each."""
    rng = np.random.default_rng(seed)
    folder = Path(folder)
    folder.mkdir(parents=True)
    stamps = 1000 + np.arange(frames) / RATE_HZ
    T = tour(frames)
    write_trajectory(folder / "trajectory.txt", Trajectory(stamps, T))
    key = np.arange(0, frames, KEYFRAME_EVERY)
    is_key = np.isin(np.arange(frames), key)
    rows = (
        (k, f"{stamps[k]:.6f}", *((900, 800, "0.8", "1.9") if is_key[k] else ("",) * 4), 1, 0, "0.1", "0.004",
         "registered", "", "keyframe" if is_key[k] else "tracked")
        for k in range(frames)
    )  # fmt: skip
    write_csv(folder / "frames.csv", FRAME_COLUMNS, rows)
    pairs = edge_pairs(key, T, rng)
    counts = rng.integers(15, 60, len(pairs))
    verdict = rng.choice(["verified", "verified", "verified", "weak", "rejected"], len(pairs))
    edges = (
        (i, j, f"{stamps[i]:.6f}", f"{stamps[j]:.6f}", count + 20, count, f"cycle{3 + (i + j) % 3}", e, v,
         *(("few_inliers", f"{count} inliers of {count + 20} matches") if v == "rejected" else ("", "")),
         f"{0.1 + 0.001 * (e % 900):.4f}", f"{0.002 + 1e-5 * (e % 900):.5f}", "0.1", "0.005", 5, *("0",) * 6, "1")
        for e, ((i, j), count, v) in enumerate(zip(pairs.tolist(), counts.tolist(), verdict.tolist(), strict=True))
    )  # fmt: skip
    write_csv(folder / "edges.csv", EDGE_COLUMNS, edges)
    believed = np.where(verdict == "rejected", 0, counts)
    px = rng.uniform(10, 470, (2, int(believed.sum()), 2)).astype(np.float32)
    np.savez(folder / "inliers.npz", offsets=np.r_[0, np.cumsum(believed)], px_i=px[0], px_j=px[1])
    covariance = np.tile(np.diag([1e-6] * 3 + [4e-6, 1e-6, 9e-6]), (frames, 1, 1))
    np.savez(folder / "covariances.npz", frames=np.arange(frames), covariance=covariance)
    write_ply(folder / "cloud.ply", *walls(T, points, rng))
    save_camera(folder / "camera.yaml", Camera(525.0, 525.0, 319.5, 239.5, 640, 480))
    write_thumbnails(folder / "thumbnails.npz", {k: picture(k) for k in range(frames)})
    summary = {"frames": frames, "registered": frames, "components": 1, "edges": int((verdict == "verified").sum())}
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder


def tour(frames):
    """(n, 4, 4) level cameras on a path that comes back to each room three times."""
    t = np.linspace(0, 6 * np.pi, frames)
    at = np.stack([8 * np.cos(t) + np.cos(9 * t), 0.1 * np.sin(40 * t), 6 * np.sin(t) + np.sin(7 * t)], axis=1)
    yaw = t + 0.8 * np.sin(5 * t)
    R = se3.exp_so3(yaw[:, None] * np.array([0, 1.0, 0])) @ se3.exp_so3(np.array([0.2, 0, 0]))
    return se3.pose(R, at)


def edge_pairs(key, T, rng):
    """(m, 2) pairs of keyframes: neighbours in time, and some of those near in space."""
    rows = np.repeat(np.arange(len(key)), 20)
    step = np.where(rng.uniform(size=len(rows)) < 0.6, rng.integers(1, 12, len(rows)), len(key) // 3)
    ends = np.stack([rows, rows + step + rng.integers(0, 3, len(rows))], axis=1)
    ends = np.unique(ends[ends[:, 1] < len(key)], axis=0)
    return key[ends]


def walls(T, points, rng):
    """Points (n, 3) and colours of walls, floors and heaps along the path."""
    at = T[rng.integers(0, len(T), points), :3, 3]
    side = rng.integers(0, 3, points)
    p = at + rng.uniform(-2.5, 2.5, (points, 3)) * [1, 0.5, 1]
    p[side == 0, 1] = 1.4 + 0.004 * rng.normal(size=(side == 0).sum())
    wall = side == 1
    p[wall, 0] = np.round(p[wall, 0] / ROOM_M) * ROOM_M + 0.004 * rng.normal(size=wall.sum())
    checker = ((p * 3).round().sum(axis=1) % 5)[:, None] * [30, 20, 10]
    return p, np.clip(60 + checker + rng.normal(scale=8, size=(points, 3)), 0, 255).astype(np.uint8)


def picture(k):
    """A thumbnail with the frame's number."""
    image = np.full((120, 160, 3), (k % 200, 90, 255 - k % 200), np.uint8)
    return thumbnail(cv2.putText(image, str(k), (20, 70), cv2.FONT_HERSHEY_SIMPLEX, 1, (255, 255, 255), 2))
