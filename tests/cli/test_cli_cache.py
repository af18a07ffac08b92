"""`miniloop cache`: it counts and removes what the store wrote, and nothing else."""

import os
import time

import numpy as np
import pytest
from command_line import invoke

from miniloop_cli.runtime.artifact_store import Artifact, Store, fingerprint
from miniloop_cli.stages.artifacts import FEATURES


@pytest.fixture
def store(tmp_path, monkeypatch):
    """Two artefacts of features, one of them last used 40 days ago, one of edges, and files of somebody else."""
    monkeypatch.setenv("MINILOOP_CACHE", str(tmp_path))
    store = Store(tmp_path)
    for kind, number in (("features", 0), ("features", 1), ("edges", 2)):
        store.save(Artifact(kind, 1), fingerprint(number), {"x": np.zeros(1000)})
    long_ago = time.time() - 40 * 86400
    os.utime(store.path(FEATURES, fingerprint(0)), (long_ago, long_ago))
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "family.npz").write_text("precious")
    (tmp_path / "features" / "notes.txt").write_text("precious")
    return store


def test_show(store):
    text = invoke("cache").stdout
    assert text == invoke("cache", "show").stdout
    assert text.startswith(f"{store.folder}: 3 files, 0.0 MB")
    assert "  features  2 files" in text
    assert "40 days ago" in text
    assert "photos" not in text


def test_show_an_absent_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MINILOOP_CACHE", str(tmp_path / "none"))
    assert "0 files" in invoke("cache").stdout
    assert not (tmp_path / "none").exists()


def test_prune_what_was_not_used(store):
    assert invoke("cache", "prune", "--older-than", 30).stdout == "removed 1 file, 0.0 MB\n"
    assert store.load(FEATURES, fingerprint(0)) is None
    assert store.load(FEATURES, fingerprint(1)) is not None


def test_use_keeps_an_artefact_young(store):
    store.load(FEATURES, fingerprint(0))
    assert invoke("cache", "prune", "--older-than", 30).stdout.startswith("removed 0 files")


def test_prune_all_leaves_what_is_not_ours(store):
    (store.folder / "edges" / f".{fingerprint(9)}.npz.4711.tmp").write_text("left by a killed run")
    assert invoke("cache", "prune", "--all").stdout.startswith("removed 4 files")
    left = {path.relative_to(store.folder).as_posix() for path in store.folder.rglob("*") if path.is_file()}
    assert left == {"photos/family.npz", "features/notes.txt"}
    assert not (store.folder / "edges").exists()


def test_both_or_neither_is_wrong_usage(store):
    assert invoke("cache", "prune").exit_code == 2
    assert invoke("cache", "prune", "--all", "--older-than", 3).exit_code == 2
