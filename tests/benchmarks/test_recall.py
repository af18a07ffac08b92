"""`python -m benchmarks recall` on a simulated recording: nearly no verified edge is lost by choosing candidates."""

import csv
import json

import pytest
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks
from miniloop_cli.api import simulate

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.mark.slow
def test_rows_and_files(tmp_path):
    folder = simulate(tmp_path / "sim", frames=14, width=320, height=240, path="loop")
    command = ["recall", str(folder), "-o", str(tmp_path / "out"), "--json", "-", "-q", "-j", "1"]
    result = CliRunner().invoke(benchmarks, command, catch_exceptions=False)
    assert result.exit_code == 0
    rows = json.loads(result.stdout)["rows"]
    assert [row["candidates"] for row in rows] == ["exhaustive", "auto", "retrieval"]
    assert rows[0]["kept"] == rows[0]["matching_share"] == 1
    assert rows[0]["verified"] > 14
    for row in rows:
        assert row["registered"] == row["frames"] == 14
        assert row["kept"] >= 0.95
        assert row["ate_cm"] < 1.1 * rows[0]["ate_cm"] + 0.1
    with (tmp_path / "out" / "recall.csv").open() as file:
        assert [row["verified"] for row in csv.DictReader(file)] == [str(row["verified"]) for row in rows]
    assert (tmp_path / "out" / "recall.png").read_bytes().startswith(b"\x89PNG")
