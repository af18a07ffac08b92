"""A real recording from end to end, its errors held against evo's."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.cli.main import cli

FRAMES = 20
LARGEST_ATE_M = 0.05  # several times what is usual, far below what a false loop would cost


@pytest.mark.slow
@pytest.mark.real
@pytest.mark.skipif(not os.environ.get("MINILOOP_TUM"), reason="MINILOOP_TUM is not set: no real frames")
@pytest.mark.parametrize("name", ["freiburg1_xyz_100"])
def test_register_and_eval_agree_with_evo(name, tmp_path, monkeypatch):
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed")
    from evo.core.sync import associate_trajectories
    from evo.tools.file_interface import read_tum_trajectory_file

    monkeypatch.setenv("MINILOOP_CACHE", str(tmp_path / "cache"))
    recording, output = Path(os.environ["MINILOOP_TUM"]) / name, tmp_path / "out"

    def run(*arguments):
        outcome = CliRunner().invoke(cli, [str(a) for a in arguments], catch_exceptions=False)
        assert outcome.exit_code == 0, outcome.output
        return json.loads(outcome.stdout)

    summary = run("register", recording, "-o", output, "--max-frames", FRAMES, "-q", "--json", "-")
    assert (summary["registered"], summary["frames"], summary["components"]) == (FRAMES, FRAMES, 1)
    found = run("eval", output, "--gt", recording, "--association", "nearest", "--json", "-")
    assert found["poses_with_ground_truth"] == FRAMES
    assert 0 < found["ate_rmse_m"] < LARGEST_ATE_M

    truth = read_tum_trajectory_file(recording / "groundtruth.txt")
    truth, estimate = associate_trajectories(truth, read_tum_trajectory_file(output / "trajectory.txt"), max_diff=0.02)
    estimate.align(truth)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((truth, estimate))
    for key in ("rmse", "mean", "median", "max"):
        assert found[f"ate_{key}_m"] == pytest.approx(error.get_statistic(metrics.StatisticsType[key]), abs=1e-6)
    for name_, relation in (("rot_deg", "rotation_angle_deg"), ("trans_m", "translation_part")):
        error = metrics.RPE(metrics.PoseRelation[relation], delta=1, delta_unit=metrics.Unit.frames)
        error.process_data((truth, estimate))
        for key in ("mean", "median"):
            expected = error.get_statistic(metrics.StatisticsType[key])
            assert found["rpe"]["consecutive"][f"{name_}_{key}"] == pytest.approx(expected, abs=1e-6)
    assert np.ptp(estimate.positions_xyz, axis=0).max() > 0.1  # the camera did move
