"""`python -m benchmarks epipolar`: true poses fit the images, others do not; so do poses of depth with its camera."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks
from benchmarks.experiments.epipolar import epipolar_rows
from miniloop_cli.datasets import open_sequence, read_ground_truth, write_trajectory
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    root = tmp_path_factory.mktemp("epipolar")
    settings = SimulationSettings(frames=8, width=320, height=240, path="xyz")
    return write_sequence(root / "recording", settings, 3)


def test_true_poses_fit_and_turned_ones_do_not(recording, tmp_path):
    sequence = open_sequence(recording)
    truth = read_ground_truth(sequence)
    result = tmp_path / "true"
    result.mkdir()
    write_trajectory(result / "trajectory.txt", truth)
    (result / "camera.yaml").write_bytes((recording / "camera.yaml").read_bytes())
    turned = truth.T_world_cam.copy()
    passed_s = truth.timestamps_s - truth.timestamps_s[0]
    turned[:, :3, :3] = turned[:, :3, :3] @ se3.exp_so3(passed_s[:, None] * np.radians([10.0, 10.0, 10.0]))
    write_trajectory(tmp_path / "turned.txt", replace(truth, T_world_cam=turned))
    judged = f"--result {result} --trajectory {tmp_path}/turned.txt -o {tmp_path}/out --json - -q"
    out = CliRunner().invoke(benchmarks, ["epipolar", str(recording), *judged.split()], catch_exceptions=False)
    rows = {row["trajectory"]: row for row in json.loads(out.stdout)["rows"] if row["apart"] == 1}
    assert rows["true"]["pairs"] >= 5
    assert rows["true"]["px"] < 0.5
    assert rows["ground truth"]["px"] == rows["true"]["px"]
    assert rows["turned"]["px"] > 3 * rows["true"]["px"]
    assert (tmp_path / "out" / "epipolar.png").stat().st_size > 1000


def test_poses_of_a_depth_camera_are_told_from_those_of_colour(recording, tmp_path):
    sequence = open_sequence(recording)
    truth = read_ground_truth(sequence)
    T_color_depth = se3.pose(se3.exp_so3(np.array([0.0, 0.15, 0.1])), np.array([0.1, 0.0, 0.0]))
    write_trajectory(tmp_path / "trajectory.txt", truth)
    own = {"fx": 300.0, "fy": 300.0, "cx": 159.5, "cy": 119.5, "width": 320, "height": 240}
    own["T_color_depth"] = T_color_depth.tolist()
    camera = yaml.safe_load((recording / "camera.yaml").read_text()) | {"depth_camera": own}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
    of_depth = replace(truth, T_world_cam=truth.T_world_cam @ T_color_depth)
    write_trajectory(tmp_path / "other.txt", of_depth)
    rows = epipolar_rows(recording, [tmp_path], [tmp_path / "other.txt"], 0, Workers(1, quiet=True))
    px = {row["poses_of"]: row["px"] for row in rows if (row["trajectory"], row["apart"]) == ("other", 1)}
    assert px["depth"] < 0.5
    assert px["colour"] > 3 * px["depth"]
