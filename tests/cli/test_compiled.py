"""Compiled kernels are those of the sources that are there."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import ROOT

from miniloop_cli.runtime import kernel_cache

ADD = "from miniloop_cli.runtime.kernels import njit\n\n\n@njit(cache=True)\ndef add(a, b):\n    return a {} b\n"
CALL = """from miniloop_cli.runtime.kernels import njit

from miniloop_cli.add import add


@njit(cache=True)
def call():
    return add(5, 2)
"""
NEEDED = (
    "errors.py",
    "runtime/__init__.py",
    "runtime/cache_folder.py",
    "runtime/kernel_cache.py",
    "runtime/kernels.py",
)


@pytest.fixture
def package(tmp_path):
    """A package with one kernel that calls another one, of another file."""
    folder = tmp_path / "miniloop_cli"
    (folder / "runtime").mkdir(parents=True)
    for name in NEEDED:
        shutil.copy(ROOT / "miniloop_cli" / name, folder / name)
    (folder / "__init__.py").touch()
    (folder / "add.py").write_text(ADD.format("+"))
    (folder / "call.py").write_text(CALL)
    return folder


def called(package, prepare="", **variables):
    """What the kernel returns, and the folder of its compiled code."""
    env = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"} | variables
    env["PYTHONDONTWRITEBYTECODE"] = "1"  # Python's own does not see a change of the same length in the same second
    code = f"{prepare}\nfrom miniloop_cli.call import call; print(call(), call.stats.cache_path)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=package.parent, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    value, folder = done.stdout.split(maxsplit=1)
    return int(value), Path(folder.strip())


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_command_line_removes_kernels_of_old_sources(package):
    prepare = "from miniloop_cli.runtime.kernel_cache import prepare_kernels_folder; prepare_kernels_folder()"
    _, first = called(package)
    (package / "add.py").write_text(ADD.format("*"))
    value, second = called(package, prepare)
    assert value == 10
    assert set(first.parent.iterdir()) == {first, second}
    os.utime(first, (0, 0))
    os.utime(second, (0, 0))
    assert called(package) == (10, second)
    assert first.exists(), "a library removes nothing"
    assert called(package, prepare) == (10, second)
    assert list(first.parent.iterdir()) == [second]


@pytest.mark.slow
def test_other_sources_compile_nothing_again(package):
    _, first = called(package)
    (package / "words.py").write_text("WORDS = 'of a message'\n")
    assert called(package) == (7, first)


@pytest.mark.slow
def test_kernels_of_others_are_kept_where_they_were(package):
    """numba's settings are not touched, and an own kernel has no part in them."""
    (package / "other.py").write_text("import numba\n\n\n@numba.njit(cache=True)\ndef other():\n    return 1\n")
    code = (
        "import numba\nbefore = dict(vars(numba.config)), list(numba.core.caching.CacheImpl._locator_classes)\n"
        "import miniloop_cli.call; miniloop_cli.call.call()\n"
        "assert before == (vars(numba.config), numba.core.caching.CacheImpl._locator_classes)\n"
        "from miniloop_cli.other import other; print(other.stats.cache_path)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=package.parent, capture_output=True, text=True, check=True,
        env={key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"},
    )  # fmt: skip
    assert Path(done.stdout.strip()) == package / "__pycache__"


@pytest.mark.slow
def test_the_users_folder_is_taken(package, tmp_path):
    """It is as safe there from old helpers."""
    value, folder = called(package, NUMBA_CACHE_DIR=str(tmp_path / "mine"))
    assert value == 7
    assert folder.is_relative_to(tmp_path / "mine")
    assert list(folder.glob("*.nbc"))
    (package / "add.py").write_text(ADD.format("-"))
    assert called(package, NUMBA_CACHE_DIR=str(tmp_path / "mine"))[0] == 3


@pytest.mark.parametrize(
    ("closed", "place"),
    [((), "__pycache__"), (("__pycache__",), "cache"), (("__pycache__", "cache"), None)],
    ids=["beside the sources", "read-only installation", "nothing can be written"],
)
def test_places(tmp_path, monkeypatch, closed, place):
    """Files stand where folders should be made: what nobody may write to, root included."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("MINILOOP_CACHE", str(tmp_path / "cache"))
    for name in closed:
        (tmp_path / name).touch()
    found = kernel_cache.kernels_folder(tmp_path)
    assert found == (place and tmp_path / place / "kernels" / kernel_cache.sources_hash(tmp_path))


@pytest.mark.slow
def test_without_any_place_a_kernel_is_compiled_and_a_command_keeps_it_for_its_own_time(package, tmp_path):
    (tmp_path / "cache").touch()
    (package / "__pycache__").touch()
    variables = {"MINILOOP_CACHE": str(tmp_path / "cache"), "TMPDIR": str(tmp_path), "TEMP": str(tmp_path)}
    assert called(package, **variables) == (7, Path("None"))
    prepare = "from miniloop_cli.runtime.kernel_cache import prepare_kernels_folder; prepare_kernels_folder()"
    value, folder = called(package, prepare, **variables)
    assert value == 7
    assert folder.is_relative_to(tmp_path)
    assert not folder.exists()
    assert not list(tmp_path.glob("miniloop-*"))


@pytest.mark.slow
def test_every_source_that_is_compiled_is_in_the_hash():
    """A constant or a function that a kernel takes from another module: that module's source is in the hash, too."""
    package = ROOT / "miniloop_cli"
    hashed = {
        path: ast.parse(text)
        for path in package.rglob("*.py")
        if any(word in (text := path.read_bytes()) for word in kernel_cache.WORDS)
    }
    assert len(hashed) > 40
    missing = []
    for path, tree in hashed.items():
        kernels = [
            node
            for node in tree.body
            if isinstance(node, ast.FunctionDef) and any("njit" in ast.unparse(one) for one in node.decorator_list)
        ]
        lines = [line for kernel in kernels for line in kernel.body]  # types in the heads are not compiled
        used = {name.id for line in lines for name in ast.walk(line) if isinstance(name, ast.Name)}
        for node in tree.body:
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("miniloop_cli"):
                continue
            for alias in node.names:
                if (alias.asname or alias.name) in used:
                    parent = ROOT.joinpath(*node.module.split("."))
                    source = parent / f"{alias.name}.py" if parent.is_dir() else parent.with_suffix(".py")
                    missing += [(path.name, node.module, alias.name)] if source not in hashed else []
    assert missing == []


WAITS = """
import time
from pathlib import Path
from numba.core import event
class Slow(event.Listener):
    def on_start(self, happened):
        Path("begun").touch()
        time.sleep({seconds})
    def on_end(self, happened):
        pass
event.register("numba:compile", Slow())
"""
SECOND = """
import time
from pathlib import Path
from miniloop_cli.runtime import kernels
kernels.PATIENCE_S = {patience}
while not Path("begun").exists():
    time.sleep(0.01)
"""
CALLS = "from miniloop_cli.call import call; print(call(), sum(call.stats.cache_misses.values()))"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seconds", "patience", "compiled"), [(0.5, 60, 0), (4, 0.1, 1)], ids=["the other one is at work", "it is stuck"]
)
def test_no_two_processes_compile_a_kernel_at_once(package, seconds, patience, compiled):
    """The second waits for the first, but not for ever."""
    codes = [WAITS.format(seconds=seconds) + CALLS, SECOND.format(patience=patience) + CALLS]
    both = [
        subprocess.Popen(
            [sys.executable, "-c", code], cwd=package.parent, stdout=subprocess.PIPE, text=True,
            env=os.environ | {"NUMBA_CACHE_DIR": str(package.parent / "kernels")},
        )
        for code in codes
    ]  # fmt: skip
    first, second = (process.communicate(timeout=60)[0].split() for process in both)
    assert first == ["7", "1"]
    assert second == ["7", str(compiled)]
