"""`register --calibrate` and `miniloop calibrate`: a wrong camera is found out, and everything says so."""

import json

import numpy as np
import pytest
import yaml
from command_line import contents, launch

from miniloop_cli.datasets.camera_files import read_camera_file
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence

TRUE_FX = 262.5


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Sixteen overlapping frames."""
    settings = SimulationSettings(frames=16, width=320, height=240, path="xyz", rolling_shutter_s=0.0)
    return write_sequence(tmp_path_factory.mktemp("calibrate") / "room", settings, seed=4)


@pytest.fixture(scope="module")
def wrong(room):
    """The camera of the room, 4 % too long."""
    camera = yaml.safe_load((room / "camera.yaml").read_text())
    path = room.parent / "wrong.yaml"
    path.write_text(yaml.safe_dump(camera | {"fx": camera["fx"] * 1.04, "fy": camera["fy"] * 1.04, "trust": "guess"}))
    return path


@pytest.mark.slow
def test_a_guess_is_calibrated_and_everything_says_so(room, wrong, tmp_path):
    done = launch("register", room, "--camera", wrong, "-o", tmp_path / "auto", "-j", 1)
    assert done.returncode == 0, done.stderr
    told = json.loads((tmp_path / "auto" / "summary.json").read_text())["calibration"]
    assert told["changed"] and told["held_out_gain"] > 0.01
    fx = told["parameters"]["fx"]
    assert fx["given"] == pytest.approx(1.04 * TRUE_FX) and fx["status"] == "estimated"
    assert abs(fx["value"] / TRUE_FX - 1) < 0.015
    camera = read_camera_file(tmp_path / "auto" / "camera.yaml")
    assert camera.fx == pytest.approx(fx["value"], abs=1e-4)
    assert "calibrated" in done.stdout and "held-out points fit" in " ".join(done.stdout.split())
    assert "calibrated: fx" in (tmp_path / "auto" / "log.txt").read_text()
    page = (tmp_path / "auto" / "report.html").read_text()
    assert "Estimated from the recording" in page and "standard deviation" in page
    # The camera that comes out is a calibrated one: with it, nothing is asked any more.
    again = launch("register", room, "--camera", tmp_path / "auto" / "camera.yaml", "-o", tmp_path / "again", "-j", 1)
    assert again.returncode == 0
    assert "calibration" not in json.loads((tmp_path / "again" / "summary.json").read_text())


@pytest.mark.slow
def test_off_is_what_a_trusted_camera_does_anyway(room, tmp_path):
    for name, more in (("auto", []), ("off", ["--calibrate", "off"])):
        assert launch("register", room, "-o", tmp_path / name, "-j", 1, *more).returncode == 0
    auto, off = contents(tmp_path / "auto"), contents(tmp_path / "off")
    assert auto["trajectory.txt"] == off["trajectory.txt"] and auto["cloud.ply"] == off["cloud.ply"]
    assert "uncertainty" not in (tmp_path / "auto" / "camera.yaml").read_text()


@pytest.mark.slow
def test_calibrate_writes_a_camera_file(room, wrong, tmp_path):
    done = launch("calibrate", room, "--camera", wrong, "-o", tmp_path / "camera.yaml", "-j", 1)
    assert done.returncode == 0, done.stderr
    found = yaml.safe_load((tmp_path / "camera.yaml").read_text())
    assert abs(found["fx"] / TRUE_FX - 1) < 0.015
    assert found["uncertainty"]["sigma"]["fx"] > 0
    size = len(found["uncertainty"]["covariance_of"])
    assert size and [len(row) for row in found["uncertainty"]["covariance"]] == [size] * size
    assert read_camera_file(tmp_path / "camera.yaml").fx == pytest.approx(found["fx"])
    assert "fx" in done.stdout and "unit of depth" in " ".join(done.stdout.split())


def test_what_cannot_be_calibrated_is_one_line(tmp_path):
    done = launch("calibrate", tmp_path / "nothing", "-o", tmp_path / "camera.yaml")
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and "does not exist" in done.stderr
    assert not (tmp_path / "camera.yaml").exists()
    assert launch("register", tmp_path, "--calibrate", "perhaps").returncode == 2


@pytest.mark.slow
def test_a_depth_camera_that_is_a_guess_is_asked_for_and_everything_says_so(shared, tmp_path):
    """Colour and depth, both taken for the same camera, as 7-Scenes has them: it is 2.5 cm and 0.5 degrees beside."""
    settings = SimulationSettings(
        frames=16, width=320, height=240, path="xyz", depth_baseline_m=0.025, depth_turn_deg=0.5, depth_focal_px=292.5
    )
    room = write_sequence(tmp_path / "room", settings, seed=4)
    guess = {"fx": 280.0, "fy": 280.0, "cx": 160.0, "cy": 120.0, "width": 320, "height": 240, "trust": "guess"}
    beside = {"depth_camera": guess | {"T_color_depth": np.eye(4).tolist()}}
    (tmp_path / "guess.yaml").write_text(yaml.safe_dump(guess | {"depth_scale": 5000} | beside))
    errors, refined = {}, {}
    for name, more in (("off", ["--calibrate", "off"]), ("auto", []), ("on", ["--calibrate", "on"])):
        out = tmp_path / name
        done = launch("register", room, "--camera", tmp_path / "guess.yaml", "-o", out, "-j", 1, *more)
        assert done.returncode == 0, done.stderr
        told = launch("eval", out, "--gt", room, "--json", "-")
        errors[name] = json.loads(told.stdout)["ate_rmse_m"]
        refined[name] = set((shared / "cache" / "refined").iterdir())
    assert errors["auto"] < 0.5 * errors["off"] and errors["auto"] < 0.005
    told = json.loads((tmp_path / "auto" / "summary.json").read_text())
    numbers = told["calibration"]["parameters"]
    assert numbers["depth_shift_x_m"]["value"] < 0  # to the left; one wall hardly tells how far
    assert numbers["depth_fx"]["value"] == pytest.approx(292.5, rel=0.02)
    assert "two cameras" in told["timings_s"]
    camera = yaml.safe_load((tmp_path / "auto" / "camera.yaml").read_text())
    assert camera["depth_camera"]["fx"] == pytest.approx(numbers["depth_fx"]["value"], rel=1e-5)
    assert "trust" not in camera["depth_camera"]
    # Who asks for it gets the same: the run with both cameras known does not ask for one of them a second time.
    assert refined["auto"] > refined["off"] and refined["on"] == refined["auto"]
    asked = yaml.safe_load((tmp_path / "on" / "camera.yaml").read_text())
    assert asked["fx"] == camera["fx"] == pytest.approx(numbers["fx"]["value"], rel=1e-5)
    assert yaml.safe_load((tmp_path / "on" / "config.yaml").read_text())["calibrate"] == "on"
    assert "depth_shift_x_m" in (tmp_path / "auto" / "report.html").read_text()
