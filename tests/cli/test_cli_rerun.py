"""`register --rerun`: the viewer's file, and what is said where the viewer's package is not installed."""

import subprocess
import sys

import pytest
from command_line import FRAMES, launch

from miniloop_cli.report import rerun as export_rerun


def test_not_installed_is_said_before_any_work(recording, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    done = launch("register", recording, "-o", tmp_path / "out", "--rerun", tmp_path / "room.rrd")
    assert done.returncode == 1
    assert "pip install 'miniloop[viz]'" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_another_package_of_the_name(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", subprocess)
    with pytest.raises(export_rerun.MiniloopError, match="not the Rerun SDK"):
        export_rerun.import_rerun()


def test_frames_cameras_cloud_edges_and_cycles(recording, tmp_path):
    pytest.importorskip("rerun", reason="the Rerun SDK is not installed")
    file = tmp_path / "new folder" / "room.rrd"
    done = launch("register", recording, "-o", tmp_path / "out", "--rerun", file, "-q")
    assert done.returncode == 0, done.stderr
    assert [path.name for path in file.parent.iterdir()] == ["room.rrd"]
    command = [sys.executable, "-m", "rerun", "rrd"]
    subprocess.run([*command, "verify", file], check=True, capture_output=True)
    text = subprocess.run([*command, "print", "-vv", file], check=True, capture_output=True, text=True).stdout
    for entity in ("/world/cloud", "/world/path", "/world/camera", "/world/camera/image", "/world/camera/depth"):
        assert entity in text, entity
    assert "/world/edges/cycle5/" in text
    assert f"{FRAMES - 1:06d}" in text
    assert "index_name: frame" in text
    assert "index_name: seconds" in text
