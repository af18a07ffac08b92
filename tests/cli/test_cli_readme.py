"""Every command of the README, run in its order as a newcomer would; the paths are those of a simulated recording."""

import re
import shlex
import shutil

import pytest
from command_line import ROOT, launch

from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence

# Installation, these tests, and the script that tests/datasets/test_fetch_script.py runs.
OTHERS = {"pip", "python", "scripts/fetch_tum.sh"}


def commands():
    """The lines of the README's shell blocks that run miniloop, as words."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for block in re.findall(r"^```sh\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        for line in re.split(r"\n|&&", block):
            words = shlex.split(line, comments=True)
            if words and words[0] == "miniloop":
                yield words[1:]
            else:
                assert not words or words[0] in OTHERS, line


@pytest.mark.slow
def test_every_command_is_run(recording, tmp_path, monkeypatch):
    pytest.importorskip("open3d", exc_type=ImportError)
    monkeypatch.chdir(tmp_path)
    for name in ("path/to/recording", "rgbd_dataset_freiburg1_xyz"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).symlink_to(recording)
    shutil.copy(next((recording / "rgb").iterdir()), tmp_path / "photo.jpg")
    (tmp_path / "kitchen").symlink_to(recording)
    write_sequence(tmp_path / "hall", SimulationSettings(frames=6, width=320, height=240), seed=5)
    ran = []
    for words in commands():
        if words[0] in ("demo", "view"):
            continue  # have tests of their own; view does not end by itself
        done = launch(*words)
        assert done.returncode == 0, (words, done.stderr)
        ran.append(words[0])
    assert {"inspect", "register", "eval", "mesh", "export", "plot", "locate"} <= set(ran)
    assert (tmp_path / "results" / "recording" / "report.html").is_file()


@pytest.mark.slow
def test_demo(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = launch("demo")
    assert done.returncode == 0, done.stderr
    assert "registered  30 of 30 frames" in done.stdout
    assert (tmp_path / "demo" / "result" / "report.html").is_file()
