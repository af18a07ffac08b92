"""Compiled kernels are those of the sources that are there."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import ROOT

from miniloop_cli.runtime import kernel_cache as compiled

ADD = "from numba import njit\n\n\n@njit(cache=True)\ndef add(a, b):\n    return a {} b\n"
CALL = """from numba import njit

from miniloop_cli.add import add


@njit(cache=True)
def call():
    return add(5, 2)
"""


@pytest.fixture
def package(tmp_path):
    """A package with one kernel that calls another one, of another file."""
    folder = tmp_path / "miniloop_cli"
    folder.mkdir()
    (folder / "runtime").mkdir()
    (folder / "runtime" / "__init__.py").touch()
    shutil.copy(ROOT / "miniloop_cli" / "runtime" / "kernel_cache.py", folder / "runtime")
    (folder / "__init__.py").write_text(
        "from miniloop_cli.runtime.kernel_cache import keep_compiled\n\nkeep_compiled()\n"
    )
    (folder / "add.py").write_text(ADD.format("+"))
    (folder / "call.py").write_text(CALL)
    return folder


def called(package, **variables):
    """What the kernel returns, and the folders of compiled kernels after it."""
    env = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"} | variables
    env["PYTHONDONTWRITEBYTECODE"] = "1"  # Python's own does not see a change of the same length in the same second
    code = "import os; from miniloop_cli.call import call; print(call(), os.environ['NUMBA_CACHE_DIR'])"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=package.parent, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    value, folder = done.stdout.split(maxsplit=1)
    return int(value), Path(folder.strip())


def test_a_kernel_never_goes_on_with_an_old_helper(package):
    """numba looks at the kernel's own file only."""
    value, first = called(package)
    assert value == 7
    assert called(package) == (7, first)
    (package / "add.py").write_text(ADD.format("-"))
    value, second = called(package)
    assert value == 3
    assert second != first
    assert set(first.parent.iterdir()) == {first, second}, "others may be at work with the first"


def test_kernels_of_old_sources_go(package):
    _, first = called(package)
    os.utime(first, (0, 0))
    (package / "add.py").write_text(ADD.format("*"))
    value, second = called(package)
    assert value == 10
    assert list(first.parent.iterdir()) == [second]


def test_other_sources_compile_nothing_again(package):
    _, first = called(package)
    (package / "words.py").write_text("WORDS = 'of a message'\n")
    assert called(package) == (7, first)


def test_the_users_folder_is_taken(package, tmp_path):
    assert called(package, NUMBA_CACHE_DIR=str(tmp_path / "mine")) == (7, tmp_path / "mine")
    assert list((tmp_path / "mine").rglob("*.nbc"))


@pytest.mark.parametrize(
    ("refused", "place"),
    [((), "__pycache__"), (("__pycache__",), "home/miniloop"), (("__pycache__", "miniloop"), "own"), (None, "")],
    ids=["beside the sources", "read-only installation", "and no home", "nothing can be written"],
)
def test_places(tmp_path, monkeypatch, refused, place):
    """A container sets XDG_CACHE_HOME, whose volume outlives an upgrade."""
    monkeypatch.setattr(compiled, "writable", lambda folder: refused is not None and folder.name not in refused)
    monkeypatch.setattr(compiled, "PACKAGE", tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("MINILOOP_CACHE", str(tmp_path / "own"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    compiled.keep_compiled()
    found = Path(os.environ["NUMBA_CACHE_DIR"])
    assert found.name == compiled.sources_hash(tmp_path)
    if place:
        assert found.parent == tmp_path / place / "kernels"
    else:
        assert found.parents[1].is_dir(), "a folder of this process"
