"""The three calls of the Python API, and what they cost before they are used."""

import subprocess
import sys

import numpy as np
import pytest
from command_line import FRAMES, environment

import miniloop_cli
from miniloop_cli.api import evaluate, register, simulate
from miniloop_cli.errors import ConfigError, InputError
from miniloop_cli.presets import load_settings
from miniloop_cli.scene.registration import RegistrationError


@pytest.mark.slow
def test_three_calls(tmp_path):
    folder = simulate(tmp_path / "room", frames=6, width=320, height=240, path="xyz", seed=5)
    run = register(folder, tmp_path / "result", settings="fast", jobs=1)
    assert list(run.poses.registered) == list(range(6))
    numbers = evaluate(tmp_path / "result", folder).numbers
    assert numbers["ate_rmse_m"] < 0.01
    assert numbers["rpe"]["edges"]["pairs"] > 5


def test_settings_object_and_bad_settings(recording, tmp_path):
    settings = load_settings("fast", ("features.count=700", "refine=none"))
    run = register(recording, tmp_path / "out", settings=settings, max_frames=3)
    assert max(len(scan.features) for scan in run.scans) <= 700
    assert np.isnan(run.covariance).all()
    with pytest.raises(ConfigError, match="did you mean"):
        register(recording, tmp_path / "never", overrides=["features.cuont=3"])
    assert not (tmp_path / "never").exists()


def test_evaluate_takes_files_and_edge_lists(registered, recording, tmp_path):
    edges = tmp_path / "edges.txt"
    edges.write_text("0 1\n0 7\n")
    whole = evaluate(registered.folder, recording)
    alone = evaluate(registered.folder / "trajectory.txt", recording / "groundtruth.txt", edges=edges)
    assert alone.numbers["ate_rmse_m"] == whole.numbers["ate_rmse_m"]
    assert alone.numbers["rpe"]["edges"]["pairs"] == 2
    assert len(whole.position_errors_m) == FRAMES
    with pytest.raises(InputError, match=r"no trajectory\.txt"):
        evaluate(tmp_path, recording)


def test_a_failed_run_is_handed_over(tmp_path):
    folder = simulate(tmp_path / "plain", frames=3, width=64, height=48, scene="textureless")
    with pytest.raises(RegistrationError, match=r"report\.html") as caught:
        register(folder, tmp_path / "out")
    assert len(caught.value.run.scans) == 3
    assert not len(caught.value.run.poses.registered)
    assert (tmp_path / "out" / "report.html").is_file()


def test_nothing_is_imported_before_it_is_asked_for():
    code = (
        "import sys, miniloop_cli; before = set(sys.modules)\n"
        "assert not {'numpy', 'click', 'pydantic', 'miniloop_cli.api'} & before\n"
        "assert callable(miniloop_cli.register) and 'miniloop_cli.api' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], env=environment(), check=True)
    with pytest.raises(AttributeError, match="regsiter"):
        miniloop_cli.__getattr__("regsiter")
