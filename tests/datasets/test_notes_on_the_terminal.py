"""What was dropped or assumed stands on stderr without being asked for; -q leaves it out; the rest comes with -v."""

import json
import subprocess
import sys

import pytest
from click.testing import CliRunner

from miniloop_cli.cli.inspect import inspect
from miniloop_cli.datasets import open_sequence
from miniloop_cli.scene.sequence import NoteKind


@pytest.fixture
def noted(tum):
    """Images of noise, of which nothing can be registered, that give notes of three kinds."""
    tum.text("rgb.txt", (tum.root / "rgb.txt").read_text() + "10.400000 rgb/10.000000.png\n")
    (tum.root / "depth/10.105000.png").unlink()
    tum.text("associations.txt", "10.0 rgb/10.000000.png 10.005 depth/10.005000.png\n")
    rows = (tum.root / "depth.txt").read_text()
    tum.text("depth.txt", rows.replace("depth/", "/data/seq/depth/"))
    notes = open_sequence(tum.root).notes
    assert {note.kind for note in notes} == {NoteKind.DROPPED, NoteKind.CONVERTED, NoteKind.UNUSED}
    return tum.root, [str(n) for n in notes if n.doubtful], [str(n) for n in notes if not n.doubtful]


def run(root, folder, *options):
    """Standard error of `miniloop register`; nothing can be registered here, so it ends with status 1."""
    words = [sys.executable, "-m", "miniloop_cli", "register", str(root), "-j", "1", "-o", str(folder), *options]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    return done.stderr.splitlines()


@pytest.mark.slow
def test_register_says_what_it_dropped(noted, tmp_path):
    root, doubtful, others = noted
    lines = run(root, tmp_path / "out")
    assert [note in lines for note in doubtful] == [True] * len(doubtful)
    assert not any(note in lines for note in others)
    assert not any(note in run(root, tmp_path / "quiet", "-q") for note in (*doubtful, *others))
    assert all(note in run(root, tmp_path / "all", "-v") for note in (*doubtful, *others))
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["notes"] == [{"kind": note.kind, "text": note.text} for note in open_sequence(root).notes]


def test_inspect_says_all(noted):
    root, doubtful, others = noted
    text = CliRunner().invoke(inspect, [str(root)]).stdout
    assert [note in text for note in (*doubtful, *others)] == [True] * len(doubtful + others)
