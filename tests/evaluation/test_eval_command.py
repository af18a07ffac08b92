"""`miniloop eval` as a person and a script use it."""

import json
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from miniloop_cli.cli.main import cli
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.geometry import se3
from miniloop_cli.scene.sequence import Trajectory


@pytest.fixture
def run_folder(tmp_path):
    """A results folder, and the ground truth of its sequence."""
    rng = np.random.default_rng(0)
    n = 20
    w, t = np.cumsum(rng.normal(scale=0.1, size=(n, 3)), axis=0), np.cumsum(rng.normal(scale=0.1, size=(n, 3)), axis=0)
    truth = Trajectory(100 + np.arange(n) / 8, se3.pose(se3.exp_so3(w), t))
    noise = se3.pose(se3.exp_so3(rng.normal(scale=0.01, size=(n, 3))), rng.normal(scale=0.01, size=(n, 3)))
    result, sequence = tmp_path / "results" / "room", tmp_path / "room"
    sequence.mkdir()
    write_trajectory(sequence / "groundtruth.txt", truth)
    write_trajectory(result / "trajectory.txt", Trajectory(truth.timestamps_s, truth.T_world_cam @ noise))
    rows = [f"{i},{i + 2},{100 + i / 8:.6f},{100 + (i + 2) / 8:.6f},verified" for i in range(n - 2)]
    (result / "edges.csv").write_text("i,j,timestamp_i,timestamp_j,verdict\n" + "\n".join(rows) + "\n")
    frames = [f"{k},{stamp:.6f}" for k, stamp in enumerate(truth.timestamps_s)]
    (result / "frames.csv").write_text("index,timestamp\n" + "\n".join(frames) + "\n")
    return result, sequence


def test_newest_result_to_json_on_stdout(run_folder, monkeypatch):
    result, sequence = run_folder
    monkeypatch.chdir(result.parent.parent)
    outcome = CliRunner().invoke(cli, ["eval", "--gt", str(sequence), "--json", "-"], catch_exceptions=False)
    data = json.loads(outcome.stdout)
    assert 0.005 < data["ate_rmse_m"] < 0.03
    assert set(data["rpe"]) == {"edges", "consecutive", "seconds"}
    assert [data["rpe"][name]["pairs"] for name in ("edges", "consecutive", "seconds")] == [18, 19, 12]
    assert {"alignment", "delta", "association"} <= set(data["protocol"])
    assert data["rpe"]["seconds"]["protocol"]["delta"] == "1 s +- 10 %"


def test_table_shows_the_protocol_and_fits(run_folder):
    result, sequence = run_folder
    arguments = ["eval", str(result), "--gt", str(sequence / "groundtruth.txt"), "--association", "nearest"]
    out = CliRunner().invoke(cli, arguments, catch_exceptions=False).stdout
    assert "SE3" in out
    assert "nearest ground-truth sample within 20 ms" in out
    assert "18 (verified edges)" in out
    assert max(len(line) for line in out.splitlines()[1:]) <= 80


def test_own_edge_list_and_files(run_folder, tmp_path):
    result, sequence = run_folder
    edges = tmp_path / "edges.txt"
    edges.write_text("0 1\n5 9\n")
    arguments = ["eval", str(result / "trajectory.txt"), "--gt", str(sequence), "--edges", str(edges)]
    arguments += ["--json", str(tmp_path / "out.json"), "--plot", str(tmp_path / "plots"), "--scale"]
    outcome = CliRunner().invoke(cli, arguments, catch_exceptions=False)
    data = json.loads((tmp_path / "out.json").read_text())
    assert data["rpe"]["edges"]["pairs"] == 2
    assert data["protocol"]["delta"]["edges"] == "edges of edges.txt"
    assert data["protocol"]["alignment"] == "Sim3"
    assert "Sim3" in outcome.stdout
    for name in ("trajectory.png", "errors.png"):
        assert (tmp_path / "plots" / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_quiet_leaves_the_table(run_folder, tmp_path):
    result, sequence = run_folder
    arguments = ["eval", str(result), "--gt", str(sequence), "--plot", str(tmp_path / "plots")]
    loud, quiet = (CliRunner().invoke(cli, [*arguments, *more], catch_exceptions=False) for more in ([], ["-q"]))
    assert "wrote" in loud.stderr
    assert quiet.stderr == ""
    assert quiet.stdout == loud.stdout
    assert (tmp_path / "plots" / "errors.png").exists()


def test_nothing_heavy_is_imported(run_folder):
    result, sequence = run_folder
    code = (
        "import sys; from miniloop_cli.cli.main import cli;"
        f"cli.main(['eval', {str(result)!r}, '--gt', {str(sequence)!r}], standalone_mode=False);"
        "heavy = {'open3d', 'cv2', 'numba', 'matplotlib', 'networkx', 'joblib', 'pydantic'} & set(sys.modules);"
        "sys.exit(', '.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["eval", "{empty}", "--gt", "{sequence}"], "no trajectory.txt"),
        (["eval", "{result}", "--gt", "{empty}"], "is empty"),
        (["eval", "--gt", "{sequence}"], "no result under"),
    ],
)
def test_what_is_missing_is_one_line(run_folder, tmp_path, arguments, words):
    result, sequence = run_folder
    (tmp_path / "empty").mkdir()
    names = {"result": str(result), "sequence": str(sequence), "empty": str(tmp_path / "empty")}
    done = subprocess.run(
        [sys.executable, "-m", "miniloop_cli", *(a.format(**names) for a in arguments)],
        capture_output=True,
        text=True,
        cwd=tmp_path / "empty",
        check=False,
        env={"PYTHONPATH": str(__import__("pathlib").Path(__file__).parents[2]), "PATH": ""},
    )
    assert done.returncode == 1
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""
