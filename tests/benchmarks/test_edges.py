"""`python -m benchmarks edges` on a simulated recording: the same edges for all rows, errors of estimates and poses."""

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks
from miniloop_cli.api import simulate

pytestmark = pytest.mark.usefixtures("own_cache")

KINDS = [
    f"{when}_{name}_{kind}"
    for when in ("before", "after")
    for name in ("deg", "cm")
    for kind in ("mean", "median", "p95")
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return simulate(tmp_path_factory.mktemp("edges") / "sim", frames=8, width=320, height=240, path="xyz")


def rows(folder, output, *arguments):
    command = ["edges", str(folder), "-o", str(output), "--json", "-", "-q", *arguments]
    result = CliRunner().invoke(benchmarks, command, catch_exceptions=False)
    assert result.exit_code == 0
    return json.loads(result.stdout)["rows"]


@pytest.mark.slow
def test_rows_and_files(folder, tmp_path):
    found = rows(folder, tmp_path, "--longest", "5", "-j", "1")
    assert [row["longest"] for row in found] == [2, 5]
    for row in found:
        assert row["scored"] == found[0]["scored"] > 20 and row["verified"] >= row["scored"] and row["wrong"] == 0
        assert row["edges"] <= 28 and row["cpu_s"] > 0
        for kind in KINDS:
            assert 0 < row[kind] < (1 if "deg" in kind else 3)
        for when in ("before", "after"):
            for name in ("deg", "cm"):
                assert row[f"{when}_{name}_p95"] > row[f"{when}_{name}_median"]
        assert row["cpu_over_pairs"] == pytest.approx(row["cpu_s"] / found[0]["cpu_s"], rel=0.05)
    errors = [[row[kind] for kind in KINDS] for row in found]
    assert not np.allclose(*errors)
    again = rows(folder, tmp_path, "--longest", "5", "-j", "2")
    assert [[row[kind] for kind in KINDS] for row in again] == errors
    with (tmp_path / "edges.csv").open() as file:
        assert [row["longest"] for row in csv.DictReader(file)] == ["2", "5"]
    assert (tmp_path / "edges.png").read_bytes().startswith(b"\x89PNG")
