"""The command line as other processes see it, and inside this process where that is not the point."""

import io
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from types import SimpleNamespace

from click.testing import CliRunner

from miniloop_cli.cli.main import cli, main

ROOT = Path(__file__).parents[2]
FRAMES = 8  # of the recording that the tests share


def environment(**changes):
    """Variables of a process that finds this checkout."""
    return os.environ | {"PYTHONPATH": str(ROOT)} | {name: str(value) for name, value in changes.items()}


def command(*arguments):
    return [sys.executable, "-m", "miniloop_cli", *map(str, arguments)]


def run_process(*arguments, cwd, **variables):
    """The finished process of a command line."""
    return subprocess.run(
        command(*arguments), capture_output=True, text=True, check=False, cwd=cwd, env=environment(**variables)
    )


def launch(*arguments):
    """The launcher inside this process, with what a process would have left: much faster than a process."""
    stdout, stderr, status = io.StringIO(), io.StringIO(), 0
    with redirect_stdout(stdout), redirect_stderr(stderr):
        try:
            main([str(argument) for argument in arguments])
        except SystemExit as done:
            status = done.code
    return SimpleNamespace(returncode=status, stdout=stdout.getvalue(), stderr=stderr.getvalue())


def invoke(*arguments):
    """A command by itself, without the launcher's handling of errors."""
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])
