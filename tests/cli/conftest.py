"""A small simulated recording and one run over it."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import FRAMES, run_process

from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence


@pytest.fixture(scope="session")
def shared(tmp_path_factory):
    """A folder for what is made once."""
    return tmp_path_factory.mktemp("cli")


@pytest.fixture(autouse=True)
def own_cache(shared, monkeypatch):
    """No test sees or fills the user's cache; without a reason to be alone, tests share one."""
    monkeypatch.setenv("MINILOOP_CACHE", str(shared / "cache"))


@pytest.fixture(scope="session")
def recording(shared):
    """Eight overlapping frames with ground truth."""
    settings = SimulationSettings(frames=FRAMES, width=320, height=240, path="xyz")
    return write_sequence(shared / "room", settings, seed=3)


@pytest.fixture(scope="session")
def registered(shared, recording):
    """The results of one run over the recording with one job, and what it printed."""
    output = shared / "results" / "room"
    done = run_process(
        "register", recording, "-o", output, "--jobs", 1, "-v", cwd=shared, MINILOOP_CACHE=shared / "cache"
    )
    assert done.returncode == 0, done.stderr
    return SimpleNamespace(folder=output, stdout=done.stdout, stderr=done.stderr)


@pytest.fixture
def copied(recording, tmp_path):
    """A copy of the recording that a test may damage."""
    return Path(shutil.copytree(recording, tmp_path / "room"))
