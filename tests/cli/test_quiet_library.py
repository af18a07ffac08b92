"""Whoever uses miniloop as a library finds the process, when a call ends, as it was before."""

import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest
from command_line import environment

from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence

# What Python itself reports of a process: files that are written, processes and variables; signals as they are set.
LISTENING = """
    import os, sys
    writing = os.O_WRONLY | os.O_RDWR | os.O_CREAT
    written, disturbed = [], []
    LOUD = ("subprocess", "os.exec", "os.fork", "os.posix_spawn", "os.spawn", "os.system", "os.kill", "os.putenv",
            "os.unsetenv")
    FILES = ("os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.truncate", "os.link", "os.symlink", "os.utime",
             "shutil.", "tempfile.")
    def listen(event, arguments):
        if event == "open" and isinstance(arguments[2], int) and arguments[2] & writing:
            written.append(os.fsdecode(arguments[0]) if not isinstance(arguments[0], int) else arguments[0])
        elif event.startswith(FILES):
            written.append(os.fsdecode(arguments[0]) if isinstance(arguments[0], (str, bytes, os.PathLike)) else event)
        elif event == "os.kill" and arguments[1] == 0:
            pass  # asks whether a process runs, and sends it nothing
        elif event.startswith(LOUD):
            disturbed.append(event)
    sys.addaudithook(listen)
"""
STATE = """
    import gc, logging, random, signal, threading, warnings
    import cv2, joblib, networkx, numba, numpy, pydantic, scipy.linalg, scipy.sparse, scipy.special, threadpoolctl, yaml
    def state():
        return {
            "variables": dict(os.environ),
            "folder": os.getcwd(),
            "signals": [signal.getsignal(number) for number in sorted(signal.valid_signals())],
            "alarm": signal.getitimer(signal.ITIMER_REAL) if hasattr(signal, "getitimer") else None,
            "hooks": (sys.unraisablehook, sys.excepthook, threading.excepthook),
            "threads": [thread.name for thread in threading.enumerate()],
            "opencv": (cv2.getNumThreads(), cv2.useOptimized(), cv2.ocl.useOpenCL()),
            "pools": {pool["filepath"]: pool["num_threads"] for pool in threadpoolctl.threadpool_info()
                      if pool["filepath"] in loaded},
            "numba": {name: value for name, value in vars(numba.config).items() if name.isupper()},
            "locators": list(numba.core.caching.CacheImpl._locator_classes),
            "numpy": (numpy.geterr(), numpy.random.get_state()[1].tolist(), random.getstate()),
            "log": (logging.root.level, list(logging.root.handlers), logging.getLogger("miniloop").level),
            "warnings": list(warnings.filters),
            "garbage": gc.get_threshold(),
            "path": list(sys.path),
        }
    loaded = {pool["filepath"] for pool in threadpoolctl.threadpool_info()}
    cv2.setNumThreads(3)
    before = state()
    del written[:], disturbed[:]  # by the libraries, while they were imported
    def changed():
        after = state()
        return [(name, before[name], after[name]) for name in before if before[name] != after[name]]
"""


@pytest.fixture(scope="module")
def textureless(tmp_path_factory):
    """Three frames that cannot be registered."""
    settings = SimulationSettings(frames=3, width=64, height=48, scene="textureless")
    return write_sequence(tmp_path_factory.mktemp("plain") / "room", settings, seed=0)


def run_alone(folder, *parts, **variables):
    """Run code in a process of its own, whose home, folder and place for temporary files are new and empty."""
    for name in ("home", "here", "temporary"):
        (folder / name).mkdir()
    temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), folder / "temporary")
    own = {"HOME": folder / "home", "PYTHONDONTWRITEBYTECODE": 1} | temporary | variables
    env = environment(**own)
    env.pop("XDG_CACHE_HOME", None)
    line = [sys.executable, "-c", "\n".join(map(dedent, parts))]
    done = subprocess.run(line, cwd=folder / "here", env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def files(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def test_an_import_changes_nothing(tmp_path):
    code = """
        import signal, threading
        def state():
            handlers = [signal.getsignal(number) for number in signal.valid_signals()]
            return dict(os.environ), handlers, threading.enumerate()
        before, modules = state(), set(sys.modules)
        import miniloop_cli
        assert state() == before
        assert (written, disturbed) == ([], [])
        print(*sorted(name for name in set(sys.modules) - modules if not name.startswith("miniloop_cli")))
    """
    imported = run_alone(tmp_path, LISTENING, code).split()
    assert {name.partition(".")[0] for name in imported} <= set(sys.stdlib_module_names)
    assert files(tmp_path) == ["here", "home", "temporary"]


@pytest.mark.slow
def test_the_three_calls_leave_the_process_as_it_was(tmp_path):
    """All cores, so that nothing is quiet for want of work; the kernels and the results are all that is written."""
    code = """
        import miniloop_cli
        folder = miniloop_cli.simulate("room", frames=6, width=320, height=240, path="xyz", seed=5)
        run = miniloop_cli.register(folder, "out", settings="fast", seed=1)
        assert len(run.poses.registered) == 6
        miniloop_cli.evaluate("out", folder)
        assert not changed(), changed()
        assert not disturbed, disturbed
        print(os.path.dirname(miniloop_cli.__file__))
        print(*(os.path.abspath(path) for path in written if not isinstance(path, int)), sep="\\n")
    """
    package, *written = run_alone(tmp_path, LISTENING, STATE, code, MINILOOP_CACHE=tmp_path / "cache").splitlines()
    places = Path(package) / "__pycache__" / "kernels", tmp_path / "cache", tmp_path / "here", Path(os.devnull)
    assert written
    assert [path for path in written if not any(map(Path(path).is_relative_to, places))] == []
    assert files(tmp_path / "home") == files(tmp_path / "temporary") == []


@pytest.mark.slow
def test_calls_that_fail_leave_the_process_as_it_was(tmp_path, textureless):
    code = f"""
        from miniloop_cli import evaluate, register, simulate
        from miniloop_cli.errors import MiniloopError
        for call in (
            lambda: register({str(textureless)!r}, "out"),
            lambda: register({str(textureless)!r}, "out", overrides=["features.cuont=3"]),
            lambda: register("absent", "out"),
            lambda: evaluate("out", "absent"),
            lambda: simulate("out"),
        ):
            try:
                call()
            except MiniloopError:
                pass
            else:
                raise AssertionError("it should have failed")
            assert not changed(), changed()
        assert not disturbed, disturbed
    """
    run_alone(tmp_path, LISTENING, STATE, code, MINILOOP_CACHE=tmp_path / "cache")
