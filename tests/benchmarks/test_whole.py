"""`python -m benchmarks whole`: vocabulary and settings that ORB-SLAM3 reads, errors of trajectories, a run of both."""

import csv
import importlib.util

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks
from benchmarks.experiments import whole
from benchmarks.side_by_side import vocabulary
from benchmarks.side_by_side.orbslam3_run import tracked
from benchmarks.side_by_side.orbslam3_settings import settings_text
from miniloop_cli.api import simulate
from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.trajectory import read_trajectory, write_trajectory
from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import fisheye_lens, radial_tangential_lens
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.simulate import true_trajectory


def read_text(path):
    """DBoW2's text form as its loader takes it: to the end of the file, a node a line."""
    head, *rows = path.read_text().split("\n")
    rows = [row.split(" ") for row in rows]
    assert all(len(row) == 35 for row in rows)
    parents, leaves = ([int(row[k]) for row in rows] for k in (0, 1))
    return head, parents, leaves, np.array([row[2:34] for row in rows], np.uint8), [float(row[34]) for row in rows]


def test_a_vocabulary_is_written_as_its_reader_expects(tmp_path, rng):
    descriptors = rng.integers(0, 256, (3000, 32), dtype=np.uint8)
    made = vocabulary.train(descriptors, np.repeat(np.arange(30), 100), rng)
    vocabulary.write(tmp_path / "words.txt", made)
    head, parents, leaves, stored, weights = read_text(tmp_path / "words.txt")
    assert head == "10 6 0 0"
    np.testing.assert_array_equal(stored, made.descriptor)
    level = [0]
    for number, parent in enumerate(parents, 1):
        assert parent < number and (parent == 0 or not leaves[parent - 1])
        level.append(level[parent] + 1)
    words = [number for number in range(1, len(level)) if leaves[number - 1]]
    assert set(range(1, len(level))) - set(parents) == set(words)
    assert {level[word] for word in words} <= {3, 4, 5, 6}
    assert np.bincount(parents).max() <= 10
    assert all((weight >= 0) if leaf else weight == 0 for weight, leaf in zip(weights, leaves, strict=True))


def test_words_are_the_medians_of_clusters_and_weigh_what_images_say(rng):
    centres = rng.integers(0, 256, (8, 32), dtype=np.uint8)
    shows = [range(40), range(20), range(10), range(5), *[range(k, 40, 4) for k in range(4)]]
    image = np.concatenate([np.repeat(list(images), 5) for images in shows])
    bits = np.unpackbits(np.repeat(centres, [5 * len(images) for images in shows], axis=0), axis=1)
    flips = rng.random(bits.shape) < 0.02
    made = vocabulary.train(np.packbits(bits ^ flips, axis=1), image, rng, levels=1)
    for centre, images in zip(centres, shows, strict=True):
        at = np.flatnonzero((made.descriptor == centre).all(axis=1))
        if len(at):  # a cluster that k-means++ found twice has two words
            assert made.weight[at[0]] >= np.log(40 / len(images)) - 1e-12
    exact = [np.log(40 / len(images)) for images in shows]
    found = {tuple(descriptor): weight for descriptor, weight in zip(made.descriptor, made.weight, strict=True)}
    right = sum(found.get(tuple(c)) == pytest.approx(w) for c, w in zip(centres, exact, strict=True))
    assert right >= 6


def test_the_same_generator_gives_the_same_vocabulary(rng):
    descriptors = rng.integers(0, 256, (500, 32), dtype=np.uint8)
    one, two = (vocabulary.train(descriptors, np.arange(500) // 50, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(one.descriptor, two.descriptor)
    np.testing.assert_array_equal(one.weight, two.weight)


def test_settings_hold_the_recordings_camera(tmp_path):
    lens = radial_tangential_lens(0.26, -0.95, -0.005, 0.0026, 1.16)
    camera = Camera(517.3, 516.5, 318.6, 255.3, 640, 480, 4000.0, lens)
    path = tmp_path / "settings.yaml"
    path.write_text(settings_text(camera, 29.7))
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)

    def value(name):
        return file.getNode(name).real()

    assert [value(f"Camera1.{name}") for name in ("fx", "fy", "cx", "cy")] == [517.3, 516.5, 318.6, 255.3]
    assert tuple(value(f"Camera1.{name}") for name in ("k1", "k2", "p1", "p2", "k3")) == lens.coefficients
    assert value("Camera.width") == 640 and value("Camera.height") == 480 and value("Camera.fps") == 30
    assert value("RGBD.DepthMapFactor") == 4000 and value("Stereo.b") * 517.3 == pytest.approx(40)
    assert "Camera1.k1: 0.0\n" in settings_text(Camera(500, 500, 320, 240, 640, 480), 30)
    with pytest.raises(InputError, match="no RGB-D mode for the lens fisheye"):
        settings_text(Camera(500, 500, 320, 240, 640, 480, lens=fisheye_lens(0.1)), 30)


def test_frames_that_orbslam3_lost_are_no_poses():
    rows = ["1.0 a", "2.0 b", "2.0 b", "2.0 b", "5.0 c"]
    assert tracked(rows) == ["1.0 a", "2.0 b", "5.0 c"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "room"
    return simulate(folder, frames=60, width=320, height=240, path="xyz", rate_hz=30.0, path_share=0.3)


@pytest.mark.slow
def test_errors_are_those_of_neighbours_in_the_recording(recording, tmp_path):
    settings = SimulationSettings(frames=60, path="xyz", rate_hz=30.0, path_share=0.3)
    truth = true_trajectory(settings, np.random.default_rng(0))
    stamps = np.array([frame.timestamp_s for frame in open_sequence(recording).frames])
    T = truth.T_world_cam[np.searchsorted(truth.timestamps_s, stamps)]
    moved = se3.pose(se3.exp_so3(np.array([0.1, 0.5, -0.3])), np.array([3.0, -1, 2])) @ T
    kept = np.r_[0:20, 30:60]  # ten frames are lost
    write_trajectory(tmp_path / "t.txt", Trajectory(stamps[kept], moved[kept]))
    row = whole.accuracy(tmp_path / "t.txt", recording)
    assert (row["poses"], row["pairs"]) == (50, 19 + 29)
    assert row["ate_cm"] < 1e-4 and row["rpe_cm"] < 1e-4 and row["rpe_deg"] < 1e-4
    moved[::2, 0, 3] += 0.01  # every other frame is off by a centimetre
    write_trajectory(tmp_path / "t.txt", Trajectory(stamps[kept], moved[kept]))
    row = whole.accuracy(tmp_path / "t.txt", recording)
    assert row["rpe_cm"] == pytest.approx(1, rel=1e-3) and row["ate_cm"] == pytest.approx(0.5, rel=0.05)


@pytest.mark.slow
def test_a_program_that_is_not_there_is_said(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(whole.importlib.util, "find_spec", lambda name: None)
    (row,) = whole.whole_rows([recording], ["orbslam3"], tmp_path)
    assert row["poses"] is None and "pip install pyorbslam3" in row["said"]


@pytest.mark.slow
def test_a_program_that_fails_is_no_result(recording, tmp_path):
    job = whole.orbslam3_job if importlib.util.find_spec("pyorbslam3") else whole.miniloop_job
    done = job(recording, tmp_path, 0)
    broken = type(done)(done.part, done.out, [done.command[0], str(tmp_path / "nothing"), "--no-such"])
    whole.measured.measure(broken.out, broken.command)
    row = whole.result(broken, recording)
    assert row["said"].startswith("failed (2)") and "poses" not in row and row["cpu_s"] > 0


@pytest.mark.slow
def test_orbslam3_runs_beside(recording, tmp_path):
    pytest.importorskip("pyorbslam3", exc_type=ImportError, reason="pyorbslam3, or a library it needs, is missing")
    command = ["whole", str(recording), "--program", "orbslam3-waits", "--runs", str(tmp_path / "runs")]
    result = CliRunner().invoke(benchmarks, [*command, "-o", str(tmp_path / "out"), "-q"], catch_exceptions=False)
    assert result.exit_code == 0
    with (tmp_path / "out" / "whole.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert row["said"] == "" and int(row["poses"]) >= 30 and float(row["ate_cm"]) < 3
    assert 0.5 < float(row["cpu_s"]) < 600 and float(row["peak_mb"]) > 50
    assert "ORB-SLAM3" in result.stdout and "of 60" in result.stdout


# Stands for Open3D's program: it reads the images as that does, and leaves the poses x = 0.1 k of all frames.
RUN_SYSTEM = """
import json, sys
import numpy as np
import open3d as o3d
assert sys.argv[1] == "--config"
settings = json.load(open(sys.argv[2]))
camera = o3d.io.read_pinhole_camera_intrinsic(settings["path_intrinsic"])
color = o3d.io.read_image(settings["path_dataset"] + "/image/000007.png")
depth = o3d.io.read_image(settings["path_dataset"] + "/depth/000007.png")
assert np.asarray(color).shape == (camera.height, camera.width, 3) and camera.intrinsic_matrix[0, 2] > 100
z = np.asarray(depth) / settings["depth_scale"]
assert 0.5 < np.median(z[z > 0]) < 5
assert sys.argv[3:] == ["--make", "--register", "--refine", "--integrate"]
import os
os.makedirs(settings["path_dataset"] + "/scene", exist_ok=True)
with open(settings["path_dataset"] + "/scene/trajectory.log", "w") as log:
    for k in range(60):
        T = np.eye(4); T[0, 3] = 0.1 * k
        log.write(f"{k} {k} {k + 1}\\n" + "\\n".join(" ".join(map(str, row)) for row in T.tolist()) + "\\n")
"""


@pytest.mark.slow
def test_open3ds_programs_get_images_and_their_poses_are_read(recording, tmp_path):
    (row,) = whole.whole_rows([recording], ["open3d"], tmp_path / "without")
    assert row["poses"] is None and "--open3d" in row["said"]
    programs = tmp_path / "reconstruction_system"
    programs.mkdir()
    (programs / "run_system.py").write_text(RUN_SYSTEM)
    (row,) = whole.whole_rows([recording], ["open3d"], tmp_path / "with", programs)
    assert row["said"] == "" and row["poses"] == 60
    left = read_trajectory(tmp_path / "with" / recording.name / "open3d" / "run.txt")
    np.testing.assert_allclose(left.T_world_cam[:, 0, 3], 0.1 * np.arange(60), atol=1e-9)
