"""Every file in examples/ does what it says."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import FRAMES, ROOT, environment

EXAMPLES = ROOT / "examples"


@pytest.fixture
def run_example(tmp_path, monkeypatch, capsys):
    """Runs a Python example as `python examples/NAME ARGUMENTS` would, and returns what it printed."""
    monkeypatch.chdir(tmp_path)

    def run(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_every_example_has_a_test():
    text = Path(__file__).read_text(encoding="utf-8")
    for path in EXAMPLES.iterdir():
        assert f'"{path.name}"' in text or path.name == "__pycache__", path.name


@pytest.mark.slow
def test_quickstart(run_example, tmp_path):
    out = run_example("quickstart.py", "here")
    assert "8 of 8 frames registered" in out
    assert float(re.search(r"error ([\d.]+) cm", out)[1]) < 1
    assert (tmp_path / "here" / "result" / "report.html").is_file()


def test_read_results(run_example, registered):
    out = run_example("read_results.py", registered.folder)
    assert f"{FRAMES} poses" in out
    assert out.count("1 sigma") == 3
    assert out.count("edge ") == 3


@pytest.mark.slow
def test_compare_settings(run_example, recording):
    lines = run_example("compare_settings.py", recording).splitlines()
    assert len(lines) == 6
    for line in lines[1:]:
        assert float(line[16:].split()[2]) < 3, line


def test_solve_a_cycle(run_example):
    out = run_example("solve_a_cycle.py")
    assert float(re.search(r"is (\S+) deg", out)[1]) < 1e-6


@pytest.fixture
def batch(tmp_path):
    """Runs batch.sh with a `miniloop` on the path."""
    (tmp_path / "bin").mkdir()
    launcher = tmp_path / "bin" / "miniloop"
    launcher.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m miniloop_cli "$@"\n')
    launcher.chmod(0o755)
    variables = environment(PATH=f"{launcher.parent}{os.pathsep}{os.environ['PATH']}")

    def run(*arguments):
        return subprocess.run(
            [EXAMPLES / "batch.sh", *arguments],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env=variables,
            check=False,
        )

    return run


@pytest.mark.slow
def test_batch(batch, recording):
    done = batch("-c", "fast", recording, "nowhere")
    assert done.returncode == 1
    head, good, bad = done.stdout.splitlines()
    assert head.split()[:3] == ["recording", "registered", "edges"]
    assert good.split()[:2] == ["room", f"{FRAMES}/{FRAMES}"]
    assert float(good.split()[3]) < 1
    assert bad.split()[:2] == ["nowhere", "failed"]
    assert len(done.stderr.splitlines()) == 1
    assert "nowhere does not exist" in done.stderr


def test_batch_usage(batch):
    done = batch()
    assert done.returncode == 2
    assert "usage" in done.stderr
