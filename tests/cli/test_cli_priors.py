"""`register --gravity` and `--pose-prior` from end to end, on scans that overlap so little that pieces fall apart."""

import json

import numpy as np
import pytest
from command_line import launch, run_process

from miniloop_cli.api import evaluate
from miniloop_cli.datasets.trajectory import read_trajectory, write_trajectory
from miniloop_cli.geometry import se3
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.sequence import Trajectory

pytestmark = pytest.mark.slow  # each needs a registered recording


@pytest.fixture(scope="module")
def weak(shared):
    """Few features, few frames, a wandering camera, an accelerometer."""
    folder = shared / "weak"
    options = "--frames 12 --width 320 --height 240 --path random-walk --rate 0.5 --seed 2 --accelerometer -q"
    assert run_process("simulate", folder, *options.split(), cwd=shared).returncode == 0
    return folder


@pytest.fixture
def registered(weak, tmp_path):
    """Numbers of a run, and its position error after alignment (RMSE, m)."""

    def run(*options):
        output = tmp_path / "out"
        done = launch("register", weak, "-o", output, "--set", "features.count=150", "-q", *options)
        assert done.returncode == 0, done.stderr
        numbers = json.loads((output / "summary.json").read_text())
        return numbers, evaluate(output, weak).numbers["ate_rmse_m"]

    return run


def tilt_deg(recording, result):
    """How far from z the result's vertical is: the turn between its poses and the true ones, but for the heading."""
    found, truth = read_trajectory(result / "trajectory.txt"), read_trajectory(recording / "groundtruth.txt")
    T_true, near = associate(found.timestamps_s, truth)
    assert near.all()
    R = se3.project_so3((found.T_world_cam[:, :3, :3] @ np.swapaxes(T_true[:, :3, :3], 1, 2)).mean(axis=0))
    return np.degrees(np.arccos(R[2, 2]))


def said(summary):
    """What became of the priors, in words."""
    return "\n".join(note["text"] for note in summary["notes"] if note["kind"] == "prior")


def test_gravity_keeps_scans_that_would_be_lost(weak, registered, tmp_path):
    free, _ = registered()
    helped, error_m = registered("--gravity", weak / "accelerometer.txt")
    assert free["registered"] + 3 <= helped["registered"]
    assert error_m < 0.05
    assert "gravity is used" in said(helped)
    assert tilt_deg(weak, tmp_path / "out") < 1.0
    # A sensor with axes of its own, as a robot's (x forward, y left, z up), in g.
    rows = np.loadtxt(weak / "accelerometer.txt")
    robot = np.column_stack([rows[:, 0], rows[:, 3] / 9.81, -rows[:, 1] / 9.81, -rows[:, 2] / 9.81])
    np.savetxt(tmp_path / "robot.txt", robot)
    same, _ = registered("--gravity", tmp_path / "robot.txt")
    assert same["registered"] == helped["registered"]
    assert "the sensor's axes as -y -z x" in said(same)
    assert tilt_deg(weak, tmp_path / "out") < 1.0


def test_gravity_of_another_recording_is_refused(weak, tmp_path):
    rows = np.loadtxt(weak / "accelerometer.txt")
    rows[:, 1:] = np.random.default_rng(0).normal(size=(12, 3)).repeat(len(rows) // 12 + 1, axis=0)[: len(rows)]
    np.savetxt(tmp_path / "other.txt", rows)
    options = ("-o", tmp_path / "out", "--set", "features.count=150", "--gravity", tmp_path / "other.txt", "-q")
    done = launch("register", weak, *options)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "other.txt: disagrees with" in done.stderr
    assert "Leave --gravity out" in done.stderr


def rough(weak, tmp_path, T_cam_new=None):
    """The truth with the drift of a bad tracker, 10 degrees and 0.3 m in the end, in a world of its own."""
    truth = read_trajectory(weak / "groundtruth.txt")
    share = np.linspace(0, 1, len(truth.timestamps_s))[:, None]
    drift = se3.pose(se3.exp_so3(share * [0, 0, np.radians(10)]), share * [0.3, 0, 0])
    world = se3.pose(se3.exp_so3(np.array([0.4, 1.0, -2.0])), np.array([5.0, 6.0, 7.0]))
    T = world @ drift @ truth.T_world_cam @ (np.eye(4) if T_cam_new is None else T_cam_new)
    write_trajectory(tmp_path / "rough.txt", Trajectory(truth.timestamps_s, T))
    return tmp_path / "rough.txt"


def test_rough_poses_keep_scans_that_would_be_lost(weak, registered, tmp_path):
    free, _ = registered()
    helped, error_m = registered("--pose-prior", rough(weak, tmp_path))
    assert free["registered"] + 3 <= helped["registered"] < helped["frames"]  # what images do not join stays out
    assert error_m < 0.05
    assert sum(helped["verdicts"].values()) <= sum(free["verdicts"].values())
    assert "pose prior is used" in said(helped)


def test_rough_poses_in_other_axes_are_refused(weak, tmp_path):
    path = rough(weak, tmp_path, np.diag([1.0, -1.0, -1.0, 1.0]))
    done = launch("register", weak, "-o", tmp_path / "out", "--pose-prior", path, "-q")
    assert done.returncode == 1
    assert "read as camera axes x right, y up, z backward" in done.stderr


@pytest.mark.parametrize("option", ["--gravity", "--pose-prior"])
def test_files_that_do_not_fit(weak, tmp_path, option):
    done = launch("register", weak, "-o", tmp_path / "out", option, tmp_path / "none.txt")
    assert done.returncode == 1
    assert "none.txt" in done.stderr
    (tmp_path / "later.txt").write_text("5000 0 0 9.8 0 0 0 1\n5000.01 0 0 9.8 0 0 0 1\n")
    done = launch("register", weak, "-o", tmp_path / "out", option, tmp_path / "later.txt")
    assert done.returncode == 1
    assert "is it of this recording?" in done.stderr
