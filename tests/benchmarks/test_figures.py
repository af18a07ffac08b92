"""Figures of README and docs come from results.json, and benchmarks write it."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.__main__ import benchmarks
from benchmarks.figures import pages, store, typed
from benchmarks.figures.store import FigureError, Figures, load, put_table, save

ROOT = Path(__file__).parents[2]
WHOLE = {"sequence": "room", "frames": 300, "program": "miniloop register", "poses": 299, "ate_cm": 0.5}
WHOLE |= {"rpe_deg": 0.25, "rpe_cm": 0.3, "cpu_s": 31.2, "wall_s": 21.6, "peak_mb": 500.4, "said": ""}
GROWTH = {"frames": 1000, "rooms": 2, "poses": 1000, "ate_cm": 0.53, "cpu_ms": 25.0, "wall_ms": 40.0, "peak_mb": 500.0}
AVERAGING = {"kind": "video", "scans": 100, "edges": 500, "outliers": 0.05, "cpu_seconds": 1.5, "seconds": 2.5}
AVERAGING |= {
    "rot_err_deg_median": 0.5,
    "rot_err_deg_mean": 0.6,
    "trans_err_median": 0.02,
    "peak_mb": 300.0,
    "load": 3.0,
}
GROWTH |= {"loops": 17, "found_share": 0.94, "between": 0, "between_share": None}


@pytest.fixture
def figures():
    runs = {"walk": {"command": "walk", "date": "2026-01-02", "commit": "abc", "machine": None}}
    values = {"walk.peak": {"what": "memory", "unit": "MB", "value": 1.5, "digits": 2, "run": "walk"}}
    values["walk.ate"] = {"what": "error", "unit": "cm", "table": "walk.all", "row": ["slow"], "column": "ATE"}
    found = Figures(runs, {}, values)
    put_table(found, "walk.all", "all walks", (["", "ATE", "said"], [["slow", 0.25, "a [b]"], ["fast", None, 'a "b"']]))
    return found


def test_every_page_is_up_to_date():
    assert pages.update(load(), check=True) == [], "run python -m benchmarks figures"


def test_pages_have_no_typed_figures():
    typed.check_typed_numbers()


def test_typed_numbers_are_found_outside_of_marks_and_code():
    text = "An error of <!--=walk.ate-->9<!--/--> cm, 3.5 cm and 12 %.\n`5 MB`\n"
    text += "```\n7 s\n```\n1,200 times, 30° x 2, 4 m/s\n33 µs, 5 of 12 frames, 100, of 9\n"
    found = [(1, "3.5 cm"), (1, "12 %"), (6, "1,200 times"), (6, "30 °"), (7, "33 µs"), (7, "5 of 12")]
    assert list(typed.typed_numbers(text)) == found
    listed = {f"README.md: {number}" for _, number in found}
    typed.compare({"README.md": text}, listed)
    with pytest.raises(FigureError, match=r"README\.md:6: '30 °' is typed by hand"):
        typed.compare({"README.md": text}, listed - {"README.md: 30 °"})
    with pytest.raises(FigureError, match=r"no page has 'README\.md: 8 s'"):
        typed.compare({"README.md": text}, listed | {"README.md: 8 s"})


def test_every_figure_is_shown_somewhere():
    figures = load()
    text = "".join(page.read_text(encoding="utf-8") for page in pages.pages())
    shown = set(re.findall(r"<!--(?:table|output)?=([\w.-]+)-->", text))
    assert {*figures.values, *figures.tables, *figures.outputs} - shown == set()


def test_marks_are_filled_and_all_else_stays(figures):
    text = "An error of <!--=walk.ate-->9<!--/--> cm, <!--=walk.peak--><!--/--> MB.\n\n"
    text += "<!--table=walk.all--><!--/table-->\n"
    table = '|  | ATE | said |\n|---|---:|---|\n| slow | 0.25 | a [b] |\n| fast | - | a "b" |'
    made = pages.filled(text, figures)
    assert made == (
        "An error of <!--=walk.ate-->0.25<!--/--> cm, <!--=walk.peak-->1.50<!--/--> MB.\n\n"
        f"<!--table=walk.all-->\n\n{table}\n\n<!--/table-->\n"
    )
    assert pages.filled(made, figures) == made
    assert pages.filled("On <!--run=walk.date--><!--/-->", figures) == "On <!--run=walk.date-->2026-01-02<!--/-->"


@pytest.mark.parametrize("start", ["", "  ", "- ", "> ", "1. "])
def test_no_line_begins_with_a_mark(figures, start):
    with pytest.raises(FigureError, match="line 2 begins with a mark"):
        pages.filled(f"The error is\n{start}<!--=walk.ate-->0.25<!--/--> cm.", figures)
    pages.filled("The error is\nof <!--=walk.ate-->0.25<!--/--> cm.\n\n<!--table=walk.all--><!--/table-->\n", figures)


def test_unknown_figures_and_runs_are_named(figures, tmp_path):
    with pytest.raises(FigureError, match=r"no figure 'walk\.nothing'"):
        pages.filled("About <!--=walk.nothing--><!--/-->", figures)
    figures.values["walk.ate"]["row"] = ["quick"]
    with pytest.raises(FigureError, match="no cell"):
        figures.value("walk.ate")
    del figures.runs["walk"]
    save(figures, tmp_path / "r.json")
    with pytest.raises(FigureError, match="names the run 'walk'"):
        load(tmp_path / "r.json")


def test_the_file_keeps_what_is_put_into_it_with_a_row_a_line(figures, tmp_path):
    save(figures, tmp_path / "r.json")
    assert load(tmp_path / "r.json") == figures
    assert '["slow", 0.25, "a [b]"]' in (tmp_path / "r.json").read_text()


def test_the_listing_names_origin_and_pages(figures):
    text = pages.listing(figures, {"walk.ate": ["README.md"]})
    assert "## walk\n\n`walk`; 2026-01-02, commit abc; machine: not noted." in text
    assert "| `walk.ate` | 0.25 cm | error | README.md |" in text
    assert "| `walk.all` | table, 2 rows | all walks |  |" in text


def test_rows_of_a_command_become_a_table(tmp_path, monkeypatch):
    path = tmp_path / "r.json"
    save(Figures(), path)
    monkeypatch.setattr(store.load, "__defaults__", (path,))
    monkeypatch.setattr(store.save, "__defaults__", (path,))
    monkeypatch.setattr("benchmarks.side_by_side.report.update", lambda figures, check: [])
    proof = AVERAGING | {"proof_edges": 475, "proof_cpu_seconds": 0.26, "certified": True, "relative_gap": 1e-6}
    rows = {"whole": WHOLE, "growth": GROWTH, "averaging": AVERAGING, "certificate-large": proof}
    for name, row in rows.items():
        (tmp_path / "rows.json").write_text(json.dumps({"rows": [row]}))
        done = CliRunner().invoke(benchmarks, ["record", name, str(tmp_path / "rows.json")])
        assert done.exit_code == 0, done.output
    found = load(path)
    assert "| room, 300 frames: miniloop register | 299 | 0.50 | 0.25 |" in found.table("whole.recordings")
    assert "| 17 | 94% | 0 | - |" in found.table("growth.rooms")
    assert found.runs["growth"]["command"] == "python -m benchmarks growth" and "note" not in found.runs["growth"]
    assert "| video, 100 scans, 500 edges, 5 % outliers | 1.50 | 2.50 | 0.50 |" in found.table("averaging.scale")
    assert "mean 3.0" in found.runs["averaging"]["note"]
    assert found.runs["averaging"]["command"] == "python -m benchmarks averaging --scans 100"
    proven = "| video, 100 scans, 475 edges | 0.30 | certified, within 0.0001 % of the lowest cost |"
    assert proven in found.table("certificate-large.video")
    assert found.runs["certificate-large"]["command"] == "python -m benchmarks averaging --scans 100 --certificate"


def test_no_measured_figure_of_the_readme_is_typed():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    text = re.sub(r"```.*?```|`[^`\n]*`|<!--=.*?<!--/-->|<!--table=.*?<!--/table-->", "", text, flags=re.DOTALL)
    assert re.findall(r"\d[\d.]* ?(?:cm|mm|s|ms|µs|MB|GB|kB|°|%|deg)\b.*", text) == []
