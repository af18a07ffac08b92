"""`python -m benchmarks`: its help, light to import, with examples that are understood; its errors in one line."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks

ROOT = Path(__file__).parents[2]
NAMES = benchmarks.list_commands(click.Context(benchmarks))


def run(*arguments):
    command = [sys.executable, "-m", "benchmarks", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)


@pytest.mark.parametrize("name", NAMES)
def test_help_has_an_example_that_is_understood(name):
    text = CliRunner().invoke(benchmarks, [name, "--help"]).stdout
    assert max(len(line) for line in text.splitlines() if "Example" not in line) <= 100
    program, _, words = re.search(r"Example: +(.*)", text)[1].partition(" benchmarks ")
    assert program == "python -m"
    first, *words = shlex.split(words)
    assert first == name
    command = benchmarks.get_command(click.Context(benchmarks), name)
    known = {option for parameter in command.params for option in parameter.opts}
    assert {word for word in words if word.startswith("-")} <= known


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from benchmarks.__main__ import benchmarks, main\n"
        "try: main(['--help'], benchmarks, 'python -m benchmarks')\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'cv2', 'numba', 'scipy', 'open3d', 'pydantic', 'networkx', 'yaml', 'rich', 'matplotlib'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    assert all(f"\n  {name} " in done.stdout for name in NAMES) and "..." not in done.stdout.partition("Commands:")[2]


@pytest.mark.slow
def test_errors_are_one_line(tmp_path):
    done = run("recall", str(tmp_path), "-q")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("miniloop: ") and done.stderr.count("\n") == 1
    assert "Did you mean 'edges'?" in run("edge").stderr
