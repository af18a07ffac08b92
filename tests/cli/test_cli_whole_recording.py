"""A whole recording from end to end: points are followed, keyframes matched, and every frame gets a pose."""

import csv
import json
import os
import shutil
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import run_process

from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence

pytestmark = pytest.mark.slow
FRAMES = 160
NO_DEPTH = (0, 1, 40, 100, 101)
REAL_FRAMES = 200
LARGEST_ATE_M = 0.0098  # half as much again as is usual: 0.65 cm


@pytest.fixture(scope="module")
def dense(shared):
    """A quarter of a turn in a room, at 30 Hz; some depth images are lost."""
    settings = SimulationSettings(frames=FRAMES, width=320, height=240, rate_hz=30, path_share=0.25)
    folder = write_sequence(shared / "dense", settings, seed=1)
    table = folder / "depth.txt"
    rows = [line for line in table.read_text().splitlines() if not line.startswith("#")]
    table.write_text("".join(f"{row}\n" for k, row in enumerate(rows) if k not in NO_DEPTH))
    return folder


def register(recording, output, cache, *more, cwd):
    done = run_process("register", recording, "-o", output, *more, cwd=cwd, MINILOOP_CACHE=cache)
    assert done.returncode == 0, done.stderr
    return output


def rows(output):
    with (output / "frames.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def summary(output):
    return json.loads((output / "summary.json").read_text())


def evaluated(output, recording, cwd):
    done = run_process("eval", output, "--gt", recording, "--json", "-", cwd=cwd)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def found(dense, shared):
    return register(dense, shared / "one job", shared / "cache of one", "--jobs", 1, cwd=shared)


def test_every_frame_has_an_accurate_pose(found, dense, shared):
    errors = evaluated(found, dense, shared)
    assert errors["poses_with_ground_truth"] == FRAMES
    assert errors["ate_rmse_m"] < 0.005
    consecutive = errors["rpe"]["consecutive"]
    assert consecutive["rot_deg_mean"] < 0.06 and consecutive["trans_m_mean"] < 0.003


def test_the_tables_say_how_each_frame_was_found(found):
    frames, told = rows(found), summary(found)
    by = Counter(row["found_by"] for row in frames)
    assert by.keys() == {"keyframe", "tracked"} and sum(by.values()) == FRAMES
    assert by["keyframe"] == told["keyframes"] and 2 <= told["keyframes"] < FRAMES / 8
    assert told["registered"] == told["frames"] == FRAMES and told["components"] == 1
    keyframes = {int(row["index"]) for row in frames if row["found_by"] == "keyframe"}
    assert {2, 80, FRAMES - 1} <= keyframes and not keyframes & set(NO_DEPTH)  # 80: where two parts meet
    for row in frames:
        assert row["status"] == "registered" and row["reason"] == ""
        assert (row["keypoints"] != "") == (row["median_depth_m"] != "") == (int(row["index"]) in keyframes)
        assert 0 <= float(row["sigma_rot_deg"]) < 2 and 0 <= float(row["sigma_trans_m"]) < 0.1
    assert sum(float(row["sigma_trans_m"]) == 0 for row in frames) <= 1  # where the world is held
    with (found / "edges.csv").open(newline="") as file:
        edges = list(csv.DictReader(file))
    assert {int(e[end]) for e in edges for end in "ij"} <= keyframes
    offsets = np.load(found / "inliers.npz")["offsets"]
    assert len(offsets) == len(edges) + 1
    # The report shows the run; there is no word of "nan" to a reader.
    assert told["verdict"]["level"] == "good"
    assert "nan" not in (found / "log.txt").read_text().lower()


def test_jobs_change_no_byte(found, dense, shared):
    other = register(dense, shared / "two jobs", shared / "cache of two", "--jobs", 2, cwd=shared)
    for name in ("trajectory.txt", "frames.csv", "edges.csv", "graph.g2o", "cloud.ply", "inliers.npz"):
        assert (other / name).read_bytes() == (found / name).read_bytes(), name


def test_without_tracking_every_frame_is_a_scan(dense, shared):
    settings = ("tracking.enabled=off", "refine=posegraph", "features.count=300", "matching.exhaustive_max_scans=2")
    settings += ("matching.retrieval_k=2", "matching.sequential_window=4")
    off = [word for setting in settings for word in ("--set", setting)]
    output = register(dense, shared / "off", shared / "cache of one", *off, cwd=shared)
    frames, told = rows(output), summary(output)
    assert told["keyframes"] == told["registered"] == told["frames"] == FRAMES - len(NO_DEPTH)
    assert "155 pairs from 160 colour and 155 depth images" in told["notes"][0]["text"]
    assert {row["found_by"] for row in frames} == {"matched"}
    assert all(row["keypoints"] for row in frames)


def test_black_broken_and_doubled_frames_are_told_apart(dense, shared):
    copy = Path(shutil.copytree(dense, shared / "damaged"))
    colors = sorted((copy / "rgb").iterdir())
    black, broken, doubled = 50, 100, 120
    cv2.imwrite(str(colors[black]), np.zeros((240, 320, 3), np.uint8))
    colors[broken].write_bytes(colors[broken].read_bytes()[:3000])
    for kind in ("rgb", "depth"):
        images = sorted((copy / kind).iterdir())
        shutil.copy(images[doubled - 1], images[doubled])
    output = register(copy, shared / "of the damaged", shared / "cache of one", cwd=shared)
    frames, told = rows(output), summary(output)
    assert [k for k, row in enumerate(frames) if row["found_by"] == ""] == [black, broken]
    assert frames[black]["status"] == "few_features" and "mean grey level 0 of 255" in frames[black]["reason"]
    assert frames[broken]["status"] == "unreadable" and f"frame {broken}" in frames[broken]["reason"]
    assert told["unreadable_frames"] == 1 and told["registered"] == FRAMES - 2 and told["components"] == 1
    poses = np.loadtxt(output / "trajectory.txt")
    at = {round(row[0], 6): row[1:4] for row in poses}
    one, other = (at[round(float(frames[k]["timestamp"]), 6)] for k in (doubled - 1, doubled))
    assert np.linalg.norm(one - other) < 0.003


@pytest.mark.real
@pytest.mark.skipif(not os.environ.get("MINILOOP_TUM"), reason="MINILOOP_TUM is not set: no real frames")
def test_real_frames_are_followed(shared, tmp_path):
    recording = Path(os.environ["MINILOOP_TUM"]) / "freiburg1_desk_whole"
    if not recording.is_dir():
        pytest.skip("no whole recording there")
    for name in recording.iterdir():
        if name.is_dir():
            (tmp_path / name.name).symlink_to(name)
        elif name.name in ("rgb.txt", "depth.txt"):
            lines = name.read_text().splitlines()
            (tmp_path / name.name).write_text("\n".join(lines[: REAL_FRAMES + 3]) + "\n")
        else:
            shutil.copy(name, tmp_path)
    output = register(tmp_path, shared / "real", shared / "cache of one", "--follow-links", cwd=shared)
    told = summary(output)
    assert told["registered"] == told["frames"] > 150  # depth begins later than colour
    assert {row["found_by"] for row in rows(output)} == {"keyframe", "tracked"}
    errors = evaluated(output, recording, shared)
    assert errors["poses_with_ground_truth"] > 150
    assert errors["ate_rmse_m"] < LARGEST_ATE_M
