"""Short versions of the scripts beside this file, which say what they do and take as many kills and inputs as given."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("resource", reason="needs POSIX")
sys.path.append(str(Path(__file__).parent))
import camera_files
import fuzz
import kills

linux = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")


@pytest.mark.slow
@linux
def test_four_kills_lose_nothing(tmp_path):
    tally = kills.campaign(tmp_path, 4, seed=1, names=("register",))
    assert sum(tally.kills.values()) >= 4
    assert tally.resumes >= 1
    assert tally.rounds >= 1
    assert tally.losses == []
    assert tally.odd_ends == []


@pytest.mark.slow
@linux
def test_hundreds_of_damaged_files(tmp_path, monkeypatch):
    monkeypatch.setenv("MINILOOP_CACHE", str(tmp_path / "cache"))
    targets, failures = fuzz.campaign(tmp_path, 600, seed=1)
    assert failures == []
    assert sum(sum(target.ends.values()) for target in targets.values()) == 600
    assert all(target.ends for target in targets.values())


@pytest.mark.slow
def test_hundreds_of_camera_files(tmp_path):
    pytest.importorskip("ruamel.yaml", reason="the independent parser")
    ends, faults = camera_files.campaign(tmp_path, 660, seed=1)
    assert faults == []
    assert sum(ends.values()) == 660
    for kind in camera_files.KINDS:
        assert ends[f"{kind}, none: read"] and ends[f"{kind}, damage: refused"]
