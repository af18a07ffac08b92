"""How well a camera is known, and camera files that hold what a calibration found."""

from dataclasses import replace

import numpy as np
import pytest

from miniloop_cli.config import Settings
from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.camera_files import read_camera_file
from miniloop_cli.datasets.camera_trust import with_trust
from miniloop_cli.datasets.intrinsics import default_camera, freiburg_camera, save_camera
from miniloop_cli.datasets.own_cameras import _from_common, with_camera
from miniloop_cli.errors import ConfigError
from miniloop_cli.geometry.camera import Camera, Trust
from miniloop_cli.geometry.camera_parameters import NAMES, CameraParameters
from miniloop_cli.geometry.lens import radial_tangential_lens
from miniloop_cli.results.calibration import uncertainty
from miniloop_cli.scene.calibration import Calibration, Status
from miniloop_cli.scene.image_source import ImageSource
from miniloop_cli.scene.sequence import Frame, Sequence
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence
from miniloop_cli.stages.two_cameras import asks_for_two_cameras

DRIVER = Camera(525.0, 525.0, 319.5, 239.5, 640, 480)
THETA = np.array([0.01, 0.002, 3.0, -2.0, 0.1, -0.2, 0.001, -0.002, 0.1, 0.004, -0.006, 0.01, 0.003, *[0.0] * 8])


def camera_file(folder, lines):
    """A complete camera file, and these lines."""
    text = "fx: 525.0\nfy: 525.0\ncx: 319.5\ncy: 239.5\nwidth: 640\nheight: 480\ndepth_scale: 5000\n"
    (folder / "camera.yaml").write_text(f"{text}{lines}\n")
    return folder / "camera.yaml"


@pytest.mark.parametrize(
    ("camera", "layout", "given", "trust"),
    [
        (DRIVER, "tum", False, Trust.CALIBRATED),  # a camera.yaml that came with the recording
        (DRIVER, "tum", True, Trust.GUESS),
        (DRIVER, "ros", False, Trust.GUESS),
        (replace(DRIVER, fx=615.3), "ros", False, Trust.FACTORY),
        (replace(DRIVER, fx=615.3), "ros", True, Trust.CALIBRATED),
        (freiburg_camera("1", "a name"), "tum", False, Trust.CALIBRATED),
        (default_camera(), "tum", False, Trust.GUESS),
        (replace(DRIVER, trust=Trust.GUESS, fx=585.0), "7-scenes", False, Trust.GUESS),
    ],
)
def test_trust_by_numbers_and_source(camera, layout, given, trust):
    assert with_trust(camera, layout, given).trust == trust


def test_a_calibrated_camera_survives_its_file(tmp_path):
    covariance = np.diag(np.linspace(1, 2, len(NAMES)) * 1e-6)
    status = np.zeros(len(NAMES), np.int64)
    found = Calibration(DRIVER, THETA, covariance, status, 1.7, 0.3, 0.01, 0.02)
    save_camera(tmp_path / "camera.yaml", found.camera, uncertainty(found))
    again = read_camera_file(tmp_path / "camera.yaml")
    assert replace(again, source=found.camera.source) == found.camera
    text = (tmp_path / "camera.yaml").read_text()
    assert "uncertainty:" in text and "covariance:" in text
    assert found.camera.lens.named["k1"] == pytest.approx(0.1)
    assert found.camera.fy / found.camera.fx == pytest.approx(np.exp(0.002))
    assert [value.name for value in found.values()][:5] == ["fx", "fy", "cx", "cy", "k1"]
    assert found.values()[0].sigma == pytest.approx(found.camera.fx * 1e-3)


def test_what_stays_is_said_to_stay():
    status = np.where(np.arange(len(NAMES)) < 4, int(Status.ESTIMATED), int(Status.NO_GAIN))
    theta = np.where(status == Status.ESTIMATED, THETA, 0.0)
    found = Calibration(DRIVER, theta, np.eye(len(NAMES)) * 1e-6, status, 1.7, 0.3, 0.01, 0.02)
    assert found.camera.lens.ideal and found.camera.depth_model.exact and found.camera.trust == Trust.CALIBRATED
    assert found.names_estimated == NAMES[:4] and found.covariance_estimated.shape == (4, 4)
    assert {value.status for value in found.values()[4:]} == {Status.NO_GAIN}


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("trust: perhaps", "trust is one of calibrated, factory, guess"),
        ("depth_offset_m: 0.01", "depth_middle_m missing"),
        ("depth_bend_per_m: -0.9\ndepth_middle_m: 1.5", "reverses near and far"),
    ],
)
def test_impossible_camera_files_are_refused(tmp_path, lines, said):
    with pytest.raises(ConfigError, match=said):
        read_camera_file(camera_file(tmp_path, lines))


def test_frames_of_their_own_camera_are_resampled_as_before(tmp_path):
    class Nowhere(ImageSource):
        name = "nothing"

        def read(self):
            raise NotImplementedError

        def header(self):
            raise NotImplementedError

        def fingerprint(self):
            return ""

    own = replace(DRIVER, fx=530.0, fy=531.0, cx=321.0, cy=238.0)
    frames = (Frame(0.0, Nowhere(), Nowhere(), camera=own), Frame(1.0, Nowhere(), Nowhere()))
    sequence = Sequence("one", tmp_path, DRIVER, frames)
    new = CameraParameters(DRIVER, THETA, 1.5).camera
    found = with_camera(sequence, new)
    assert found.camera == new and found.frames[1].camera is None
    np.testing.assert_allclose(_from_common(found.frames[0].camera, new), _from_common(own, DRIVER), atol=1e-9)


@pytest.mark.slow
def test_a_depth_camera_survives_its_file_and_is_read_with_the_recording(tmp_path):
    settings = SimulationSettings(frames=2, width=64, height=48, depth_baseline_m=0.025, depth_turn_deg=0.5)
    folder = write_sequence(tmp_path / "two", settings, 1)
    own = settings.depth_camera
    sequence = open_sequence(folder)
    assert np.allclose(sequence.depth_camera.T_color_depth, own.T_color_depth, atol=1e-12)
    assert sequence.depth_camera.camera.fx == own.camera.fx and not sequence.depth_camera.sees_as(sequence.camera)
    assert any("a separate depth camera" in note.text for note in sequence.notes)
    guess = replace(own, camera=replace(own.camera, trust=Trust.GUESS, lens=radial_tangential_lens(0.1)))
    save_camera(tmp_path / "guess.yaml", settings.camera, depth_camera=guess)
    again = open_sequence(folder, camera_path=tmp_path / "guess.yaml").depth_camera
    assert again.camera.trust == Trust.GUESS and again.camera.lens.named["k1"] == 0.1
    assert asks_for_two_cameras(open_sequence(folder, camera_path=tmp_path / "guess.yaml"), Settings())
    assert not asks_for_two_cameras(sequence, Settings())
    assert asks_for_two_cameras(sequence, Settings(calibrate="on"))


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("depth_camera: 3", "four rows of four numbers"),
        ("depth_camera: {fx: 500, T_color_depth: [1, 2]}", "must be four rows of four numbers"),
        ("depth_camera: {fx: 500, T_color_depth: [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}", "must be a rotation"),
        ("depth_camera: {fx: 500, T_color_depth: [[1,0,0,25],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}", "shift in metres"),
        ("depth_camera: {fx: 500, T_color_depth: [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}", "fy, cx, cy"),
        ("depth_camera: {fd: 500, T_color_depth: [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}", "unknown key 'fd'"),
    ],
)
def test_impossible_depth_cameras_are_refused(tmp_path, lines, said):
    with pytest.raises(ConfigError, match=said):
        read_camera_file(camera_file(tmp_path, lines))
