"""Names that break scripts and pages: spaces, markup, line breaks, bytes that are no text; results in the recording."""

import json
import os
import shutil
from pathlib import Path

import pytest
from command_line import FRAMES, contents, run_process

MARKUP = "<script>alert(1)</script>".replace("/", "\N{DIVISION SLASH}")
ODD = os.fsdecode(f"sp ace é \n'{MARKUP}\" & ".encode() + b"\xff")


@pytest.fixture
def odd(recording, tmp_path):
    """The recording under an odd name, its first image too."""
    folder = tmp_path / ODD
    try:
        shutil.copytree(recording, folder)
    except OSError as error:
        pytest.skip(f"the file system takes no such name ({error})")
    table = (folder / "rgb.txt").read_text().splitlines()
    image = Path(table[-1].split()[1])
    renamed = f"rgb/a {MARKUP} é.png"
    (folder / image).rename(folder / renamed)
    table[-1] = f"{table[-1].split()[0]} {renamed}"
    (folder / "rgb.txt").write_text("\n".join(table) + "\n", encoding="utf-8")
    return folder


@pytest.mark.slow
def test_odd_names_from_end_to_end(odd, registered, tmp_path):
    output = odd / "out"  # results may lie in the recording itself
    for _ in range(2):
        done = run_process("register", odd, "-o", output, "-j", 1, cwd=tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
    expected = contents(registered.folder)
    made = contents(output)
    assert {name for name in expected if made.get(name) != expected[name]} <= {
        *("summary.json", "log.txt", "report.html", "map/map.json")  # they name the recording
    }
    assert json.loads(made["summary.json"])["recording"] == str(odd)
    page = (output / "report.html").read_text(encoding="utf-8")
    assert MARKUP not in page
    assert "&lt;script&gt;alert(1)" in page
    log = (output / "log.txt").read_text(encoding="utf-8").splitlines()
    assert log[1].startswith("recording: ") and log[1].endswith(f"(layout tum, {FRAMES} frames)")
    done = run_process("eval", output, "--gt", odd, "--json", "-", cwd=tmp_path)
    assert json.loads(done.stdout)["poses_with_ground_truth"] == FRAMES
    done = run_process("export", output, "--to", "colmap", "-o", tmp_path / "colmap", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(list((tmp_path / "colmap" / "images").glob("*.png"))) == FRAMES


@pytest.mark.slow
def test_odd_names_in_messages_stay_one_line(odd, tmp_path):
    for arguments in (("register", odd / "none"), ("eval", odd, "--gt", odd), ("export", odd, "--to", "tum")):
        done = run_process(*arguments, cwd=tmp_path)
        assert done.returncode == 1
        assert done.stderr.count("\n") == 1
        assert "\\x0a" in done.stderr
