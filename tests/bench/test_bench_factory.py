"""The command that is made of a benchmark: what it shows, what it writes."""

import csv
import json
import sys
from types import SimpleNamespace

import click
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure

from miniloop_cli.cli.bench.factory import Benchmark, Column, command, numbers, whole

ROWS = [
    {"name": "a", "share": 0.25, "paper_share": 0.3, "count": 3, "good": True},
    {"name": "b", "share": None, "paper_share": None, "count": 12, "good": False},
    {"name": "b", "other": 1.5},
]
SHOWN = """
the a
x            share   count    good
a        25% (30%)       3     yes

the b
x            share   count    good
b                -      12      no

x      other
b        1.5
"""


@pytest.fixture
def made(monkeypatch):
    """The command, and what its function was called with."""
    called = {}

    def rows(**chosen):
        called.update(chosen)
        yield from ROWS

    monkeypatch.setitem(sys.modules, "made_up", SimpleNamespace(rows=rows, draw=lambda rows: Figure()))
    benchmark = Benchmark(
        "made-up",
        "Short.",
        "Long.",
        rows="made_up:rows",
        draw="made_up:draw",
        heading="the {name}",
        columns=(
            Column("x", "{name}", "<4"),
            Column("share", "{share:.0%} ({paper_share:.0%})", ">14"),
            *numbers(">8", ".4g", "count", "good", other="other"),
        ),
        options=(whole("--times", 1, 2, "Times."), click.argument("sequences", nargs=-1)),
    )
    return command(benchmark), called


def test_rows_are_shown_under_heads_and_written(made, tmp_path):
    result = CliRunner().invoke(made[0], ["s", "--times", "5", "--seed", "7", "-j", "1", "-o", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert result.stdout == SHOWN
    chosen = made[1]
    assert (chosen["sequences"], chosen["times"], chosen["seed"], chosen["workers"].jobs) == (("s",), 5, 7, 1)
    with (tmp_path / "made-up.csv").open() as file:
        assert [row["other"] for row in csv.DictReader(file)] == ["", "", "1.5"]
    assert (tmp_path / "made-up.png").read_bytes().startswith(b"\x89PNG")


def test_json_on_stdout_stands_alone(made, tmp_path):
    result = CliRunner().invoke(made[0], ["--json", "-", "-o", str(tmp_path)])
    assert json.loads(result.stdout) == {"rows": ROWS}
    assert f"Written: {tmp_path}" in result.stderr
    quiet = CliRunner().invoke(made[0], ["--json", "-", "-q", "-o", str(tmp_path)])
    assert quiet.stderr == "" and made[1]["workers"].quiet
