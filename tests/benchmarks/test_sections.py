"""Single sections of BENCHMARK.md from the rows of a command."""

import json

import pytest
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks

PAGE = "# Benchmarks\n\nwords\n\n## Matching\n\na\n\n## Averaging at scale\n\nb\n"
WHOLE = {
    "sequence": "room",
    "frames": 300,
    "program": "miniloop register",
    "poses": 299,
    "ate_cm": 0.5,
    "rpe_deg": 0.25,
}
WHOLE |= {"rpe_cm": 0.3, "cpu_s": 31.2, "wall_s": 21.6, "peak_mb": 500.4, "said": ""}
GROWTH = {"frames": 1000, "rooms": 2, "poses": 1000, "ate_cm": 0.53, "cpu_ms": 25.0, "wall_ms": 40.0, "peak_mb": 500.0}
GROWTH |= {"loops": 17, "found_share": 0.94, "between": 0, "between_share": None}


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "B.md"
    path.write_text(PAGE)
    return path


def put(name, rows, page):
    given = page.with_name("rows.json")
    given.write_text(json.dumps({"rows": rows}))
    done = CliRunner().invoke(benchmarks, ["section", name, str(given), "-o", str(page)])
    assert done.exit_code == 0, done.output
    return page.read_text()


def test_a_section_is_added_and_replaced_and_the_others_stay(page):
    text = put("whole", [WHOLE], page)
    assert text.startswith(PAGE.rstrip()) and "| room, 300 frames: miniloop register | 299 | 0.50 | 0.25 |" in text
    assert "| 500 |" in text
    more = put("growth", [GROWTH], page)
    assert more.startswith(text.rstrip()) and "| 17 | 94% | 0 | - |" in more
    again = put("whole", [WHOLE | {"poses": 300}], page)
    assert again == more.replace("| 299 |", "| 300 |")
