"""Layouts of other packages: found by the commands, and never in the way of a recording that they do not concern."""

import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from command_line import FRAMES, ROOT, invoke, launch, run_process
from plugin_package import install

from miniloop_cli.datasets import known_layouts, open_sequence, read_ground_truth, read_scan, read_trajectory
from miniloop_cli.datasets.numbered import RATE_HZ
from miniloop_cli.datasets.registry import BUILT_IN, GROUP, find_layout
from miniloop_cli.errors import InputError

PACKAGE = Path(__file__).parent / "zipped_robot"


def project(name, value, package="broken"):
    return f'[project]\nname = "{package}"\nversion = "1"\n[project.entry-points."{GROUP}"]\n{name} = "{value}"\n'


@pytest.fixture
def site(tmp_path):
    """A site folder with the package of zipped recordings."""
    code = (PACKAGE / "zipped_robot.py").read_text()
    return install(tmp_path / "site", (PACKAGE / "pyproject.toml").read_text(), "zipped_robot", code)


@pytest.fixture
def zipped(recording, tmp_path):
    """The shared recording in one zip file, frame numbers in place of stamps."""
    sequence = open_sequence(recording)
    truth = read_ground_truth(sequence)
    rows = (recording / "groundtruth.txt").read_text().splitlines()[1:]
    camera = sequence.camera
    with zipfile.ZipFile(tmp_path / "kitchen.zip", "w") as archive:
        lines = []
        for k, frame in enumerate(sequence.frames):
            archive.write(frame.color.path, f"image-{k:04d}.png")
            archive.write(frame.depth.path, f"range-{k:04d}.png")
            row = rows[int(np.abs(truth.timestamps_s - frame.timestamp_s).argmin())]
            lines.append(f"{k} {row.partition(' ')[2]}\n")
        archive.writestr("path.txt", "".join(lines))
        lens = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, camera.depth_scale)
        archive.writestr("lens.txt", " ".join(map(str, lens)))
    return tmp_path / "kitchen.zip"


def test_a_package_that_is_installed_meanwhile_is_found(tmp_path, monkeypatch):
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(site)
    monkeypatch.syspath_prepend(tmp_path / "no-such-folder")
    assert "late" not in known_layouts()
    install(site, project("late", "broken:Layout"), "broken", "")
    assert "late" in known_layouts()


@pytest.mark.slow
def test_the_commands_read_recordings_of_a_plug_in(site, zipped, registered, tmp_path):
    """A process of its own finds the package; frames come out of the archive, which is never unpacked."""
    paths = os.pathsep.join([str(site), str(ROOT)])

    def run(*arguments):
        done = run_process(*arguments, cwd=tmp_path, PYTHONPATH=paths)
        assert done.returncode == 0, done.stderr
        return done.stdout

    looked = json.loads(run("inspect", zipped, "--json", "-"))
    assert (looked["layout"], looked["frames"], looked["broken"]) == ("zipped-robot", FRAMES, [])
    run("register", zipped, "--jobs", 1, "-o", tmp_path / "result")
    ours = read_trajectory(tmp_path / "result" / "trajectory.txt")
    same = read_trajectory(registered.folder / "trajectory.txt")
    np.testing.assert_allclose(ours.timestamps_s, np.arange(FRAMES) / RATE_HZ, atol=1e-6)
    np.testing.assert_allclose(ours.T_world_cam, same.T_world_cam, atol=1e-3)
    scores = json.loads(run("eval", tmp_path / "result", "--gt", zipped, "--json", "-"))
    assert scores["poses_with_ground_truth"] == FRAMES and scores["ate_rmse_m"] < 0.01
    run("export", tmp_path / "result", "--to", "nerfstudio", "--sequence", zipped, "-o", tmp_path / "nerf")
    frames = json.loads((tmp_path / "nerf" / "transforms.json").read_text())["frames"]
    assert all((tmp_path / "nerf" / frame["file_path"]).is_file() for frame in frames)
    assert all((tmp_path / "nerf" / frame["depth_file_path"]).is_file() for frame in frames)
    assert sorted(path.name for path in zipped.parent.iterdir()) == ["kitchen.zip", "nerf", "result", "site"]


def test_images_of_an_archive_are_those_of_the_files(site, zipped, recording, monkeypatch):
    monkeypatch.syspath_prepend(site)
    ours, same = read_scan(open_sequence(zipped), 2), read_scan(open_sequence(recording), 2)
    assert np.array_equal(ours.color, same.color) and np.array_equal(ours.depth_m, same.depth_m)


def test_plug_ins_are_tried_first_and_named(site, monkeypatch):
    assert list(known_layouts()) == list(BUILT_IN)
    monkeypatch.syspath_prepend(site)
    assert list(known_layouts()) == ["zipped-robot", *BUILT_IN]
    assert "zipped-robot" in invoke("inspect", site, "--layout", "unknown").exception.args[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import missing_vendor_sdk", "ModuleNotFoundError: No module named 'missing_vendor_sdk'"),
        ("def f(:", "SyntaxError"),
        ("", "AttributeError"),
        ("class Layout:\n    def __init__(self): 1 / 0", "ZeroDivisionError"),
        ("class Layout:\n    def matches(self, root): return True", "lacks matches, open or ground_truth"),
    ],
)
def test_a_plug_in_that_cannot_be_loaded_is_left_out(recording, tmp_path, monkeypatch, caplog, code, reason):
    module = f"broken_layout_{abs(hash(code))}"
    monkeypatch.syspath_prepend(install(tmp_path, project("broken", f"{module}:Layout"), module, code))
    done = launch("inspect", recording, "--json", tmp_path / "out.json")
    assert done.returncode == 0 and json.loads((tmp_path / "out.json").read_text())["layout"] == "tum"
    (line,) = caplog.messages
    assert "layout 'broken' of the package broken" in line and reason in line and line.endswith("it is left out")
    asked = launch("inspect", recording, "--layout", "broken")
    assert asked.returncode == 1 and reason in asked.stderr and len(asked.stderr.splitlines()) == 1


def test_a_plug_in_that_fails_at_looking_is_left_out(recording, tmp_path, monkeypatch, caplog):
    code = (
        "class Layout:\n    def matches(self, root): return 1 / 0\n"
        "    def open(self, root, camera_path): pass\n    def ground_truth(self, sequence): pass\n"
    )
    monkeypatch.syspath_prepend(install(tmp_path, project("looking", "looking_layout:Layout"), "looking_layout", code))
    assert open_sequence(recording).layout == "tum"
    assert "layout 'looking' cannot look at" in caplog.text and "ZeroDivisionError" in caplog.text


def test_a_plug_in_cannot_take_the_name_of_another_layout(tmp_path, monkeypatch, caplog):
    monkeypatch.syspath_prepend(install(tmp_path, project("tum", "other:Layout", "other"), "other", ""))
    assert known_layouts()["tum"] is BUILT_IN["tum"]
    assert "layout 'tum' of the package other is left out" in caplog.text
    with pytest.raises(InputError, match=r"unknown layout 'tun'; did you mean 'tum'\?"):
        find_layout("tun")
