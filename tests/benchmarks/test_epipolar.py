"""`python -m benchmarks epipolar`: true poses fit the images, others do not, whichever camera they are of."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks
from miniloop_cli.datasets import open_sequence, read_ground_truth, write_trajectory
from miniloop_cli.geometry import se3
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
    rows = {row["trajectory"]: row for row in json.loads(out.stdout)["rows"]}
    assert rows["true"]["pairs_1"] >= 5
    assert rows["true"]["px_1"] < 0.5
    assert rows["ground truth"]["px_1"] == rows["true"]["px_1"]
    assert rows["turned"]["px_1"] > 3 * rows["true"]["px_1"]
    assert (tmp_path / "out" / "epipolar.png").stat().st_size > 1000
