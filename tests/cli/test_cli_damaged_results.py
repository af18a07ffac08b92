"""A file of a results folder that came to harm is noticed in one line by whoever reads the folder."""

import shutil
from pathlib import Path

import pytest
from command_line import launch

pytestmark = pytest.mark.slow  # each needs a registered recording

DAMAGES = {
    "half of it": (lambda text: text[: text.index("cx")], "cx, cy, width, height, depth_scale missing"),
    "cut in a word": (lambda text: text[: text.index("cx") + 1], "not a YAML file"),
    "nothing left": (lambda text: "", "expected lines like 'fx: 525.0'"),
    "zeros": (lambda text: "\0" * len(text), "not a YAML file"),
    "no number": (lambda text: text.replace("fx: ", "fx: x"), "fx must be a finite number"),
    "another image": (lambda text: text.replace("width: 320", "width: 32000"), "width must be"),
}


@pytest.fixture
def result(registered, tmp_path):
    """A copy of a results folder that a test may damage."""
    return Path(shutil.copytree(registered.folder, tmp_path / "result"))


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_camera(result, recording, damage):
    change, words = DAMAGES[damage]
    path = result / "camera.yaml"
    path.write_text(change(path.read_text()))
    before = {path.name for path in result.iterdir()}
    for arguments in (("eval", result, "--gt", recording), ("export", result, "--to", "tum"), ("mesh", result, "-q")):
        done = launch(*arguments)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
        assert done.stderr.startswith(f"miniloop: {path}:")
        assert words in done.stderr
    assert {path.name for path in result.iterdir()} == before


def test_a_camera_given_stands_in_for_a_damaged_one(result, recording, tmp_path):
    (result / "camera.yaml").write_text("")
    arguments = ("export", result, "--to", "nerfstudio", "-o", tmp_path / "out")
    assert launch(*arguments).returncode == 1
    assert launch(*arguments, "--camera", recording / "camera.yaml").returncode == 0


def test_the_camera_file_of_another_program_is_not_ours_to_judge(result, recording):
    (result / "camera.yaml").write_text("%YAML:1.0\nCamera.fx: 517.3\n")
    (result / "summary.json").unlink()
    assert launch("eval", result / "trajectory.txt", "--gt", recording).returncode == 0


def test_why_the_recording_cannot_be_opened_is_told(result, recording):
    summary = result / "summary.json"
    summary.write_text(summary.read_text().replace(str(recording), str(recording) + "-gone"))
    assert launch("export", result, "--to", "tum").returncode == 0
    done = launch("export", result, "--to", "colmap")
    assert done.returncode == 1
    assert f"give the recording with --sequence ({recording}-gone does not exist)" in done.stderr
