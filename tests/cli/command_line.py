"""The command line as other processes see it, and inside this process where that is not the point."""

import io
import json
import os
import re
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
        command(*arguments),
        capture_output=True,
        text=True,
        errors="surrogateescape",
        check=False,
        cwd=cwd,
        env=environment(**variables),
    )


def launch(*arguments, command=cli):
    """The launcher inside this process, with what a process would have left: much faster than a process."""
    stdout, stderr, status = io.StringIO(), io.StringIO(), 0
    with redirect_stdout(stdout), redirect_stderr(stderr):
        try:
            main([str(argument) for argument in arguments], command)
        except SystemExit as done:
            status = done.code
    return SimpleNamespace(returncode=status, stdout=stdout.getvalue(), stderr=stderr.getvalue())


def invoke(*arguments):
    """A command by itself, without the launcher's handling of errors."""
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def contents(folder):
    """Content of every file below a results folder, without dates and seconds: what two runs must agree on.

    This is the one place that says where times are: `timings_s` in summary.json, the date and the seconds in log.txt,
    and both once more in report.html, which shows them.
    """
    found = {}
    for path in folder.rglob("*"):
        if not path.is_file():
            continue
        content = path.read_bytes()
        if path.name == "summary.json":
            content = json.dumps(json.loads(content) | {"timings_s": None}).encode()
        elif path.name in ("log.txt", "report.html"):
            content = re.sub(rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC", b"", content)
            content = re.sub(rb"seconds:\n(  .*\n)+", b"", content)
            content = re.sub(rb'<table class="times">.*?</table>', b"", content, flags=re.DOTALL)
        found[path.relative_to(folder).as_posix()] = content
    return found


def differing(folder, other):
    """Names of the files in which two results folders differ, beyond times, or that only one of them has."""
    left, right = contents(folder), contents(other)
    return sorted(name for name in left.keys() | right.keys() if left.get(name) != right.get(name))
